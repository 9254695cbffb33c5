"""A configuration tree as text: what can be set in it, as a TOML file and as a list of options."""

import dataclasses
import json
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tomlkit

from laploop.configuration import allowed, alternatives, field_docs, to_plain

_WIDTH = 100

_WRITTEN = "hz=Hz seconds=s n=N pa=Pa w=W mps=m/s mps2=m/s^2 radps=rad/s radps2=rad/s^2 rad_s=rad/s n_m=N/m ns_m=Ns/m"
_UNITS = dict(pair.split("=") for pair in _WRITTEN.split()) | {
    unit: unit for unit in ("s", "ms", "m", "mm", "px", "rad", "deg")
}
"""By the last words of a field's name."""


@dataclass(frozen=True, kw_only=True)
class Leaf:
    """One field of a tree that holds a value, not a configuration of its own."""

    path: tuple[str, ...]
    annotation: Any
    value: Any
    """In the tree, as a file holds it; None too where it lies in an alternative that the tree has not chosen."""
    doc: str
    allowed: str
    """In words; empty where its type says it all."""

    @property
    def unit(self) -> str:
        """Of its value, by its name; empty where it has none."""
        *_, before_last, last = ("", *self.path[-1].split("_"))
        return _UNITS.get(f"{before_last}_{last}", _UNITS.get(last, ""))

    @property
    def note(self) -> str:
        """Its meaning, what is allowed, and its unit."""
        bounds, none = self.allowed.removesuffix(", or none"), ", or none" if self.allowed.endswith(", or none") else ""
        if re.search(r"\d", bounds):
            bounds = f"{bounds} {self.unit}".rstrip()
        return " ".join([*self.doc.split(), *([f"({bounds}{none})"] if bounds else [])])


def leaves(tree: Any) -> dict[tuple[str, ...], Leaf]:
    """Return everything that can be set in a tree, by its path, the fields of alternatives that are not chosen too."""
    found: dict[tuple[str, ...], Leaf] = {}
    for leaf in _walk(type(tree), to_plain(tree), tree, ()):
        before = found.get(leaf.path)
        if before is not None and get_origin(leaf.annotation) is Literal:
            # The `kind` that tells the alternatives of a union apart.
            kinds = (*get_args(before.annotation), *get_args(leaf.annotation))
            one_of = f"one of {', '.join(map(str, kinds))}"
            leaf = replace(before, annotation=Literal[kinds], allowed=one_of)  # noqa: PLW2901
        elif before is not None and before.value is not None:
            # A field of the alternative that is chosen, which others have too.
            continue
        found[leaf.path] = leaf
    return found


def _walk(kind: type, plain: Any, tree: Any, path: tuple[str, ...]) -> Iterator[Leaf]:
    hints, docs = get_type_hints(kind, include_extras=True), field_docs(kind)
    for field in dataclasses.fields(kind):
        name, annotation = field.name, hints[field.name]
        value, there = (None, None) if tree is None else (plain[name], getattr(tree, name))
        nested: list[Any] = [one for one in kinds_of(annotation) if dataclasses.is_dataclass(one)]
        if dataclasses.is_dataclass(there):
            # A tree may hold a subclass of what its field is declared to be, as a task does.
            chosen: Any = type(there)
            yield from _walk(chosen, value, there, (*path, name))
            nested = [one for one in nested if not issubclass(chosen, one)]
        for one in nested:
            yield from _walk(one, None, None, (*path, name))
        if not nested and not dataclasses.is_dataclass(there):
            words = allowed(kind, (name,))
            yield Leaf(path=(*path, name), annotation=annotation, value=value, doc=docs.get(name, ""), allowed=words)


def kinds_of(annotation: Any) -> list[Any]:
    """Return the types that a field may have, without their bounds."""
    return [get_args(one)[0] if get_origin(one) is Annotated else one for one in alternatives(annotation)]


def toml_text(tree: Any) -> str:
    """Return a tree as a TOML file, each field with its meaning, bounds and unit as a comment."""
    return "\n".join(_table(tree, leaves(tree), ())).strip() + "\n"


def _table(tree: Any, known: Mapping[tuple[str, ...], Leaf], path: tuple[str, ...]) -> Iterator[str]:
    summary = (type(tree).__doc__ or "").strip().partition("\n\n")[0]
    yield from ("", *_comment(summary), *([f"[{'.'.join(path)}]"] if path else []))
    names = [field.name for field in dataclasses.fields(tree)]
    for name in names:
        if (leaf := known.get((*path, name))) is not None:
            yield from ("", *_comment(leaf.note), f"{name} = {toml_value(leaf.value)}")
    for name in names:
        if (*path, name) not in known:
            yield from _table(getattr(tree, name), known, (*path, name))


def _comment(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), _WIDTH, initial_indent="# ", subsequent_indent="# ")


def toml_value(value: Any) -> str:
    """Write a value on one line; TOML has no null."""
    if value is None:
        return '"none"'
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {toml_value(one)}' for key, one in value.items())}}}"
    return str(tomlkit.item(value).as_string())


def option_name(path: tuple[str, ...], root: str = "") -> str:
    """Return the option that sets a field; paths below the root are written without it."""
    return "--" + ".".join(path[1:] if path[0] == root else path).replace("_", "-")


def options_text(tree: Any, root: str = "") -> str:
    """Return every option of a tree with its value, its meaning and what is allowed."""
    lines = []
    for leaf in leaves(tree).values():
        value = "" if leaf.value is None else f"  (now {toml_value(leaf.value)})"
        lines.append(f"  {option_name(leaf.path, root)}{value}")
        lines += textwrap.wrap(leaf.note, _WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines) + "\n"
