"""Docstrings that are written like Markdown, as the reStructuredText that Sphinx expects."""

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

_HEADING = re.compile(r"#{1,6} (?P<title>.+)")
_CODE = re.compile(r"(`[^`]*`)")


def restructured(lines: list[str]) -> list[str]:
    """Return a docstring with headings, tables, bars and stars as reStructuredText has them.

    Headings become bold lines, since a docstring stands below headings of its page; text in backticks stays as it is.
    """
    result: list[str] = []
    literal = False
    for is_table, group in groupby(lines, lambda line: line.lstrip().startswith("|") and line.rstrip().endswith("|")):
        if is_table:
            result += ["", *_list_table(list(group)), ""]
            continue
        for line in group:
            # What `::` announces is indented, and taken as it is.
            literal = literal and (not line or line[0] == " ")
            result.append(line if literal else _heading(line) or _escaped(line))
            literal = literal or line.endswith("::")
    return result


def _heading(line: str) -> str:
    found = _HEADING.fullmatch(line)
    return "" if found is None else f"**{found['title']}**"


def _escaped(line: str) -> str:
    return "".join(part if part.startswith("`") else re.sub(r"([*|])", r"\\\1", part) for part in _CODE.split(line))


def _list_table(lines: list[str]) -> Iterator[str]:
    indent = lines[0][: len(lines[0]) - len(lines[0].lstrip())]
    yield f"{indent}.. list-table::"
    yield f"{indent}   :header-rows: 1"
    yield ""
    for number, line in enumerate(lines):
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if number == 1 and all(set(cell) <= set("-: ") for cell in cells):
            continue
        for column, cell in enumerate(cells):
            yield f"{indent}   {'* -' if column == 0 else '  -'} {cell}"


class _Around:
    """What happens to a docstring before and after napoleon."""

    def __init__(self) -> None:
        self.text: list[str] = []

    def before(self, _app: Any, _what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
        lines[:] = restructured(lines)
        self.text = list(lines)

    def after(self, _app: Any, what: str, _name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
        # Napoleon takes what stands before a field's first colon for its type.
        if what in {"attribute", "property", "data"}:
            lines[:] = self.text


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx, around napoleon's place of 500."""
    around = _Around()
    app.connect("autodoc-process-docstring", around.before, priority=400)
    app.connect("autodoc-process-docstring", around.after, priority=600)
    return {"parallel_read_safe": True}
