"""Links, anchors and options in pages lead somewhere."""

import re
import shlex
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from generated_pages import filled
from page_runner import blocks_of

from laploop.cli.main import COMMANDS
from laploop.cli.parsing import arguments_class, option_names
from laploop.cli.tree import leaves, option_name
from laploop.envs import TASKS, EpisodeConfig

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
IDS = [page.relative_to(ROOT).as_posix() for page in PAGES]


def text_of(page):
    """Return a page as the site has it, without its code."""
    text = page.read_text()
    if page.is_relative_to(DOCS):
        text = re.sub(r"<!-- generated: contents -->", "", text)
        text = filled(text, page.relative_to(DOCS).with_suffix("").as_posix()) if "<!-- generated" in text else text
    return text


def anchors_of(page):
    headings = re.findall(r"^#{1,6} (.+)$", re.sub(r"```.*?```", "", text_of(page), flags=re.DOTALL), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=IDS)
def test_every_link_leads_somewhere(page):
    wrong = []
    for link in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)):
        if re.match(r"[a-z]+:", link):
            parts = urlsplit(link)
            if parts.scheme != "https" or "." not in parts.netloc:
                wrong.append(link)
            continue
        if link.startswith("/gallery/"):
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists() or (anchor and anchor not in anchors_of(target)):
            wrong.append(link)
    assert wrong == []


def test_the_gallery_has_every_picture_below_a_command_that_draws_it():
    sections = (DOCS / "pictures.md").read_text().split("\n## ")[1:]
    shown = [name for section in sections for name in re.findall(r"\]\(pictures/(.+?)\)", section)]
    assert sorted(shown) == sorted(path.name for path in (DOCS / "pictures").iterdir())
    assert [section for section in sections if not section.partition("![")[0].count("```sh")] == []


def command_lines():
    for page in PAGES:
        for block in blocks_of(page.read_text()):
            if block.language == "sh":
                for line in block.text.replace("\\\n", " ").splitlines():
                    if (found := re.search(r"(?:^|\s)laploop ([a-z][\w-]*)(.*)", line.partition(" #")[0])) is not None:
                        yield page.relative_to(ROOT).as_posix(), found[1], found[2]


def test_every_option_in_the_pages_exists():
    fields = {option_name(path, "task") for task in TASKS.names() for path in leaves(EpisodeConfig.of(task=task))}
    known = {command: {*option_names(arguments_class(command))} for command in COMMANDS if command != "train"}
    wrong = []
    for page, command, rest in command_lines():
        options = [word.partition("=")[0] for word in shlex.split(rest) if word.startswith("--")]
        if command not in COMMANDS:
            wrong.append((page, command))
        elif command != "train":
            takes = known[command] | (fields if command in {"run", "trials", "config"} else set()) | {"--help", "--help-all"}
            wrong += [(page, command, option) for option in options if option not in takes]
    assert wrong == []


def test_every_name_that_pages_import_is_there():
    wrong = []
    for page in PAGES:
        for block in blocks_of(page.read_text()):
            for line in re.findall(r"^from laploop.*$", block.text, flags=re.MULTILINE) if block.language == "python" else ():
                try:
                    exec(line, {})  # noqa: S102  our own pages
                except ImportError as error:
                    wrong.append((page.name, str(error)))
    assert wrong == []
