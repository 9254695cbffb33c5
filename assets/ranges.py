"""Ranges from which a scope, its optics or a tissue's appearance are drawn."""

from dataclasses import fields
from typing import Any, TypeVar

from laploop.errors import InvalidValueError

T = TypeVar("T")

Span = tuple[T, T]
"""Lowest and highest value, both included; `Span[Albedo]` has the bounds of an albedo."""


def check_ordered(ranges: Any) -> None:
    """Raise an InvalidValueError if the lower end of a range of a configuration is above its upper one."""
    for field in fields(ranges):
        span = getattr(ranges, field.name)
        if isinstance(span, tuple) and not span[0] <= span[1]:
            raise InvalidValueError(field.name, span, "low <= high")
