"""What `reset` may be given."""

from collections.abc import Collection, Mapping
from numbers import Integral

from laploop.errors import InvalidValueError, UnknownNameError


def check_reset(seed: object, options: object, allowed: Collection[str]) -> None:
    """Refuse what `reset` cannot take, before any work starts.

    Raises:
        UnknownNameError: If there is an option that is not among those allowed.
        InvalidValueError: If the seed is not an integer from 0 on, or the options are no mapping.
    """
    if seed is not None and (isinstance(seed, bool) or not isinstance(seed, Integral) or not 0 <= int(seed) < 2**63):
        raise InvalidValueError("seed", seed, "an integer from 0 to 2**63 - 1, or None")
    if options is None:
        return
    if not isinstance(options, Mapping):
        raise InvalidValueError("options", options, "a mapping, or None")
    for name in options:
        if name not in allowed:
            raise UnknownNameError("option of reset", name, allowed)
