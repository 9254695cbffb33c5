"""What `reset` of a task takes."""

from collections.abc import Mapping, Sequence
from numbers import Integral
from typing import Any

from laploop.errors import InvalidValueError, UnknownNameError


def check_reset(seed: Any, options: object, known: Sequence[str]) -> None:
    """Check the arguments of a reset whose options have the known names.

    Raises:
        UnknownNameError: If there is no such option.
        InvalidValueError: If the seed is not an integer from 0 on, or the options are no mapping.
    """
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= int(seed) < 2**63):
        raise InvalidValueError("seed", seed, "an integer from 0 to 2**63 - 1, or None")
    if options is not None and not isinstance(options, Mapping):
        raise InvalidValueError("options", options, "a mapping, or None")
    for name in options or {}:
        if name not in known:
            raise UnknownNameError("option of reset", name, known)
