import re
import sys
from pathlib import Path

import pytest
from command_reference import commands_markdown
from configuration_reference import configuration_markdown
from docstring_markup import restructured
from generated_pages import REPOSITORY, filled
from markdown_table import table
from mathml import mathml
from public_reference import public_markdown
from site_map import CONTENTS
from task_reference import tasks_markdown

from laploop.cli.main import COMMANDS
from laploop.cli.parsing import arguments_class, option_names
from laploop.cli.tree import leaves, option_name
from laploop.envs import TASKS, EpisodeConfig

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md"))


@pytest.fixture(scope="module")
def commands():
    return commands_markdown()


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"train"}))
def test_a_command_lists_each_option_with_its_bounds(command, commands):
    section = re.search(rf"^## `laploop {command}`\n(.*?)(?=^## |\Z)", commands, flags=re.DOTALL | re.MULTILINE)[1]
    for option in option_names(arguments_class(command)):
        assert f"`{option}`" in section
    if command == "speed":
        assert (
            "| `--frames` | `INT` | `301` | Frames that are timed; the paper's number. (an integer, 10 to 1000000) |" in section
        )
        assert "| `--out` | `PATH` | **required** |" in section


def test_training_lists_what_each_network_adds(commands):
    section = commands.split("## `laploop train`")[1].split("## `laploop trials`")[0]
    assert "`--dataset`" in section.split("With `--model")[0]
    added = section.split("With `--model ssle-phase` also:")[1]
    assert "`--reader`" in added.split("With `--model")[0]


def test_every_field_of_every_task_has_a_row():
    text = configuration_markdown()
    for task in TASKS.names():
        for path, leaf in leaves(EpisodeConfig.of(task=task)).items():
            if path != ("task", "kind"):
                assert f"| `{option_name(leaf.path, 'task')}` |" in text
    assert "| `--loop.camera-hz` | `25.0` | Hz | 0.5 to 1000 |" in text
    # The same in all tasks stands once.
    assert text.count("| `--loop.camera-hz` |") == 1
    assert "Of `scan` alone." in text


def test_public_names_are_documented_by_kind():
    text = public_markdown("control")
    assert ".. autoclass:: laploop.control.RcmController\n   :members:" in text
    assert ".. autofunction:: laploop.control.make_controller" in text
    assert "Names: ``reach``" in text


def test_every_task_shows_its_docstring_below_its_name():
    text = tasks_markdown()
    for name in TASKS.names():
        assert f"| [{name}](#{name}) | `laploop/{name.capitalize()}-v0` |" in text
        assert (TASKS.get(name).environment_class.__doc__ or "").splitlines()[0] in text.split(f"\n## {name}\n")[1]
        assert (DOCS / "tasks" / f"{name}.md").is_file()


def test_every_page_is_in_the_contents_once():
    listed = [page for sections in CONTENTS.values() for pages in sections.values() for page in pages]
    assert sorted(listed) == sorted({*listed})
    assert {*PAGES} - {"index"} == {*listed} - {"gallery/index"}


def test_a_marker_becomes_text_and_links_out_of_the_docs_lead_to_the_repository():
    text = "[a](../assets/weights) [b](../../CHANGELOG.md#added) [c](../time.md) [d](../examples/reach.py)\n"
    assert filled(text, "page").startswith(f"[a]({REPOSITORY}assets/weights)")
    nested = filled(text.replace("../examples", "../../examples"), "room/page")
    assert f"[b]({REPOSITORY}CHANGELOG.md#added) [c](../time.md) [d](/gallery/reach.rst)" in nested
    assert "/tutorials/first_loop" in filled("<!-- generated: contents -->", "tutorials/index")
    with pytest.raises(KeyError):
        filled("<!-- generated: nothing -->", "page")


def test_columns_without_any_entry_are_left_out():
    assert table(("a", "b", "c"), [("1", "", "x|y"), ("2", "", "z")]) == "| a | c |\n| --- | --- |\n| 1 | x\\|y |\n| 2 | z |"


def test_docstrings_like_markdown_become_restructured_text():
    lines = ["## Info", "", "| key | meaning |", "|---|---|", "| `a|b` | x * y |", "", "Code::", "", "    |x| * y", "", "f(*z)"]
    made = restructured(["Of `*args`.", *lines[:1], *lines[2:4], "| `a` | x |", "", *lines[6:]])
    assert made[:2] == ["Of `*args`.", "**Info**"]
    assert "   * - key" in made
    assert "     - x" in made
    assert "    |x| * y" in made
    assert made[-1] == r"f(\*z)"


def test_formulas_need_no_script():
    made = mathml(r"\sigma_Z = \frac{\tau Z^2}{2 \pi b}", block=True)
    assert made.startswith("<math")
    assert "<mfrac>" in made


def test_every_formula_of_the_pages_can_be_drawn():
    formulas = [
        formula for page in DOCS.rglob("*.md") for formula in re.findall(r"\$\$(.+?)\$\$", page.read_text(), flags=re.DOTALL)
    ]
    assert formulas
    assert all(mathml(formula, block=True) for formula in formulas)


def test_the_settings_of_the_site_name_extensions_that_exist(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    names: dict = {"__file__": str(DOCS / "conf.py")}
    exec(compile((DOCS / "conf.py").read_text(), "conf.py", "exec"), names)  # noqa: S102  our own settings
    for name in ("docstring_markup", "generated_pages", "mathml"):
        assert name in names["extensions"]
        assert (DOCS / "extensions" / f"{name}.py").is_file()
