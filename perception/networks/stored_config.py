"""Network configurations rebuilt from the plain data that is stored beside weights."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from laploop.errors import InvalidValueError, WeightsError

Config = TypeVar("Config")


def stored_config(kind: type[Config], described: Mapping[str, Any], path: Path) -> Config:
    """Build a frozen configuration, nested ones included, from what `dataclasses.asdict` made of it.

    Args:
        kind: The dataclass.
        described: Its fields, and perhaps `format`, which is not one.
        path: Where it comes from, for the message.

    Raises:
        WeightsError: If a field is unknown, missing or out of range.
    """
    given = {name: value for name, value in described.items() if name != "format"}
    hints = get_type_hints(kind)
    names = {item.name for item in fields(kind)}  # type: ignore[arg-type]
    if given.keys() != names:
        found, wanted = sorted(given), sorted(names)
        raise WeightsError(f"{path} describes a network by {found}; allowed: {wanted}")
    values: dict[str, Any] = {}
    for name, value in given.items():
        hint = hints[name]
        if is_dataclass(hint) and isinstance(hint, type) and isinstance(value, Mapping):
            values[name] = stored_config(hint, value, path)
        else:
            values[name] = tuple(value) if isinstance(value, list) else value
    try:
        return kind(**values)
    except (InvalidValueError, TypeError) as error:
        raise WeightsError(f"{path} describes an impossible network: {error}") from error
