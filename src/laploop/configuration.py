"""Configuration trees: frozen, strict dataclasses that say at each field what is allowed.

`@configuration` makes one. A field's unit stands in its name, its bounds in its annotation, its meaning in the docstring below:

    @configuration
    class ProbeConfig:
        speed_mps: Annotated[float, Field(gt=0.0, le=0.2)] = 0.05
        \"\"\"Speed at which the probe approaches.\"\"\"

Values of another type are refused, and so are NaN and infinity. Checks between fields go into `__post_init__`. Whatever is
refused raises one of `laploop.errors`, which names the field by its path.
"""

import ast
import dataclasses
import functools
import inspect
import numbers
import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as pydantic_dataclass
from pydantic_core import to_json

from laploop.errors import InvalidValueError, LaploopError, UnknownNameError

__all__ = [
    "Field",
    "Seed",
    "Workers",
    "allowed",
    "alternatives",
    "at_path",
    "configuration",
    "field_docs",
    "from_plain",
    "merged",
    "to_plain",
]

T = TypeVar("T")

Seed = Annotated[int, Field(ge=0, lt=2**63)]
Workers = Annotated[int, Field(ge=1, le=256)]
"""Number of processes."""

_CONFIG = ConfigDict(strict=True, allow_inf_nan=False, extra="forbid", validate_default=True, arbitrary_types_allowed=True)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(dataclasses.field, Field))
def configuration(cls: type[T]) -> type[T]:
    """Make a class a frozen, keyword-only, strict dataclass whose errors are laploop's own."""
    made: Any = pydantic_dataclass(frozen=True, kw_only=True, config=_CONFIG)(cls)
    validating_init = made.__init__

    @functools.wraps(validating_init)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:  # noqa: N807
        try:
            validating_init(self, *args, **{name: _plain_number(name, value) for name, value in kwargs.items()})
        except ValidationError as error:
            raise _translated(made, error) from None

    made.__init__ = __init__
    return made  # type: ignore[no-any-return]


def from_plain(kind: type[T], values: Mapping[str, Any], *, source: str = "") -> T:
    """Make a configuration from what a file holds: tables, lists, text, numbers.

    Args:
        kind: A class made by `configuration`.
        values: Its fields; nested configurations as mappings, tuples as lists, paths as text, and `"none"` for None, which
            TOML does not have.
        source: Where the values come from, for the message.

    Raises:
        LaploopError: If a value is not allowed; the message names its path.
    """
    try:
        made: T = _adapter(kind).validate_json(to_json(_with_none([kind], values), inf_nan_mode="constants"))
    except ValidationError as error:
        raise _translated(kind, error, source) from None
    return made


def to_plain(tree: Any) -> dict[str, Any]:
    """Return a configuration as what JSON and TOML know; `from_plain` takes it back."""
    plain: dict[str, Any] = _adapter(type(tree)).dump_python(tree, mode="json")
    return plain


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables with others laid over them; a table of another `kind` takes the place of the whole."""
    result = dict(base)
    for key, value in over.items():
        before: Any = result.get(key)
        same = (
            isinstance(before, Mapping)
            and isinstance(value, Mapping)
            and value.get("kind", before.get("kind")) == before.get("kind")
        )
        result[key] = merged(before, value) if same else value
    return result


def at_path(path: str, value: Any) -> dict[str, Any]:
    """Return nested tables that hold a value alone, at a dotted path; `merged` lays them over others."""
    for part in reversed(path.split(".")):
        value = {part: value}
    found: dict[str, Any] = value
    return found


@functools.cache
def field_docs(kind: type) -> Mapping[str, str]:
    """Return the docstrings below a class's fields, by name, those of its bases included."""
    docs: dict[str, str] = {}
    for cls in reversed(kind.__mro__):
        if not dataclasses.is_dataclass(cls):
            continue
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(cls))).body
        for field, doc in pairwise(getattr(definition, "body", [])):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(doc, ast.Expr):
                docs[field.target.id] = inspect.cleandoc(str(ast.literal_eval(doc.value)))
    return docs


def allowed(kind: type, path: Sequence[str | int]) -> str:
    """Return in words what a field, named by its path from a configuration, may be; empty where nothing bounds it."""
    return _in_words(_resolved(kind, path)[1])


def alternatives(annotation: Any) -> tuple[Any, ...]:
    """Return the members of an annotation that is a union, or the annotation alone."""
    if get_origin(annotation) is Annotated:
        inner = alternatives(get_args(annotation)[0])
        return inner if len(inner) > 1 else (annotation,)
    if get_origin(annotation) in {Union, UnionType}:
        return tuple(one for part in get_args(annotation) for one in alternatives(part))
    return (annotation,)


_adapter: Callable[[Any], TypeAdapter[Any]] = functools.cache(TypeAdapter)
"""Made once a class, when it is first needed."""


def _with_none(annotations: Sequence[Any], value: Any) -> Any:
    """Put None where a file says "none" of a field that may be it."""
    kinds = [_bare(one) for annotation in annotations for one in alternatives(annotation)]
    if value == "none" and type(None) in kinds:
        return None
    if not isinstance(value, Mapping):
        return value
    return {
        name: _with_none([found for kind in kinds if (found := _member(kind, name)) is not None], one)
        for name, one in value.items()
    }


def _plain_number(name: str, value: Any) -> Any:
    """Turn numpy's scalars into Python's; refuse what a strict float would take all the same, such as a tensor."""
    if value is None or isinstance(value, bool | int | float | str):
        return value.item() if isinstance(value, np.generic) else value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple):
        return tuple(_plain_number(name, one) for one in value)
    if isinstance(value, numbers.Number) or hasattr(value, "__float__"):
        raise InvalidValueError(name, value, "a plain number")
    return value


def _translated(kind: type, error: ValidationError, source: str = "") -> LaploopError:
    """Return one of pydantic's errors, the deepest, as one of ours: among those of a union it knows best what was meant."""
    found = max(error.errors(include_url=False), key=lambda one: len(one["loc"]))
    path, annotation = _resolved(kind, found["loc"])
    name = ".".join(map(str, path))
    context = found.get("ctx", {})
    cause = context.get("error")
    translated: LaploopError
    if isinstance(cause, LaploopError):
        translated = cause.at(name) if name else cause
    elif found["type"] in {"unexpected_keyword_argument", "extra_forbidden"}:
        translated = UnknownNameError("field", name, _field_names(_resolved(kind, found["loc"][:-1])[1]))
    elif found["type"] == "union_tag_invalid":
        translated = UnknownNameError(f"kind of {name}", context["tag"], context["expected_tags"].replace("'", "").split(", "))
    elif found["type"] == "literal_error":
        translated = UnknownNameError(name.replace("_", " "), found["input"], _literals(annotation))
    elif found["type"].startswith("missing"):
        translated = InvalidValueError(name, "missing", _in_words(annotation) or "a value")
    else:
        message = found["msg"].removeprefix("Input should be ")
        translated = InvalidValueError(name or kind.__name__, found["input"], _in_words(annotation) or message)
    return translated.at(source, ": ") if source else translated


def _resolved(kind: Any, location: Sequence[str | int]) -> tuple[tuple[str | int, ...], Any]:
    """Follow pydantic's location of an error; return the path of the field, and its annotation.

    A location also names the members of unions that it goes through, by their type or their `kind`; a path does not.
    """
    path: list[str | int] = []
    annotation = kind
    for part in location:
        choices = alternatives(annotation)
        members = [found for one in choices if (found := _member(one, part)) is not None]
        chosen = [one for one in choices if part in {_kind(one), getattr(one, "__name__", "")}]
        if members:
            path.append(part)
            annotation = members[0]
        elif len(chosen) == 1:
            annotation = chosen[0]
        elif part == location[-1] and len(choices) == 1:
            path.append(part)
    return tuple(path), annotation


def _bare(annotation: Any) -> Any:
    return get_args(annotation)[0] if get_origin(annotation) is Annotated else annotation


def _kind(annotation: Any) -> Any:
    """Return the value of the field `kind` that tells a member of a union from the others."""
    field = getattr(_bare(annotation), "__dataclass_fields__", {}).get("kind")
    return None if field is None else field.default


def _member(annotation: Any, name: str | int) -> Any:
    annotation = _bare(annotation)
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return get_type_hints(annotation, include_extras=True).get(str(name))
    if get_origin(annotation) is tuple and isinstance(name, int):
        parts = get_args(annotation)
        return parts[0] if Ellipsis in parts else parts[min(name, len(parts) - 1)]
    return None


def _field_names(annotation: Any) -> list[str]:
    kinds = [_bare(one) for one in alternatives(annotation)]
    return [field.name for kind in kinds if dataclasses.is_dataclass(kind) for field in dataclasses.fields(kind)]


def _literals(annotation: Any) -> list[str]:
    found = [_bare(one) for one in alternatives(annotation)]
    return [str(value) for one in found if get_origin(one) is Literal for value in get_args(one)]


def _in_words(annotation: Any) -> str:
    """Return what an annotation allows, such as `above 0, at most 5`."""
    members = alternatives(annotation)
    if len(members) > 1:
        return ", or ".join(filter(None, map(_in_words, members)))
    kind = _bare(annotation)
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(str, get_args(kind)))
    bounds = _bounds(annotation)
    if get_origin(kind) is tuple:
        return _tuple_in_words(kind, bounds)
    if not bounds:
        return _NOUNS.get(kind, "")
    noun = "an integer, " if kind is int else ""
    if "multiple_of" in bounds:
        noun = f"a multiple of {_shown(bounds.pop('multiple_of'))}, "
    if bounds.keys() == {"ge", "le"}:
        return f"{noun}{_shown(bounds['ge'])} to {_shown(bounds['le'])}"
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    return noun + ", ".join(f"{word} {_shown(bounds[key])}" for key, word in words.items() if key in bounds)


_NOUNS = {
    float: "a finite number",
    int: "an integer",
    bool: "true or false",
    str: "text",
    Path: "a path",
    type(None): "none",
}


def _tuple_in_words(annotation: Any, bounds: Mapping[str, float]) -> str:
    parts = get_args(annotation)
    if Ellipsis not in parts:
        count = f"{len(parts)} values"
    else:
        count = f"{bounds['min_length']} to {bounds['max_length']} values" if bounds else "any number of values"
    each = {words for part in parts if part is not Ellipsis and (words := _in_words(part))}
    return f"{count}, each {each.pop()}" if len(each) == 1 else count


def _bounds(annotation: Any) -> dict[str, float]:
    if get_origin(annotation) is not Annotated:
        return {}
    declared = [one for extra in get_args(annotation)[1:] for one in (extra, *getattr(extra, "metadata", ()))]
    return {key: getattr(one, key) for one in declared for key in _BOUNDS if getattr(one, key, None) is not None}


_BOUNDS = ("gt", "ge", "lt", "le", "multiple_of", "min_length", "max_length")


def _shown(number: float) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"
