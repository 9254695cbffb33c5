"""Fill in what pages leave to the code: `<!-- generated: NAME -->` becomes Markdown when the site is built.

Pages stay readable where they are not built. Links out of `docs/` lead to the repository, those to examples to the gallery,
which has none of those in folders of their own.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from command_reference import commands_markdown
from configuration_reference import configuration_markdown
from public_reference import public_markdown
from site_map import contents_markdown
from task_reference import tasks_markdown

REPOSITORY = "https://github.com/laploop/laploop/blob/main/"

_MARKER = re.compile(r"<!-- generated: (?P<name>[\w-]+)(?: (?P<argument>\S+))? -->")
_LINK_OUT = re.compile(r"(?P<before>\]\()(?:\.\./)+(?P<path>(?!\.\.)[^)#\s]+)(?P<anchor>#[^)\s]*)?\)")


def filled(text: str, docname: str) -> str:
    """Return a page with its markers and outward links replaced.

    Raises:
        KeyError: If a marker names nothing that is generated.
    """
    makers: dict[str, Callable[[str | None], str]] = {
        "commands": lambda _: commands_markdown(),
        "configuration": lambda _: configuration_markdown(),
        "contents": lambda _: contents_markdown(docname),
        "public": lambda package: public_markdown(str(package)),
        "tasks": lambda _: tasks_markdown(),
    }
    text = _MARKER.sub(lambda found: makers[found["name"]](found["argument"]), text)
    return _LINK_OUT.sub(lambda found: _outward(found, docname), text)


def _outward(found: re.Match[str], docname: str) -> str:
    depth = docname.count("/")
    climbs = found[0].count("../")
    if climbs <= depth:
        return found[0]
    path, anchor = found["path"], found["anchor"] or ""
    if (example := re.fullmatch(r"examples/(\w+)\.py", path)) is not None:
        return f"](/gallery/{example[1]}.rst)"
    return f"]({REPOSITORY}{path}{anchor})"


def _on_source_read(_app: Any, docname: str, content: list[str]) -> None:
    if not docname.startswith("gallery/"):
        content[0] = filled(content[0], docname)


def _on_get_outdated(_app: Any, env: Any, _added: set[str], _changed: set[str], _removed: set[str]) -> list[str]:
    """Have pages that the code fills in read again in every build: Sphinx cannot see that the code has changed."""
    return [name for name in env.found_docs if "<!-- generated:" in Path(env.doc2path(name)).read_text(encoding="utf-8")]


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("env-get-outdated", _on_get_outdated)
    app.connect("source-read", _on_source_read)
    return {"parallel_read_safe": True}
