"""Names that fields of the loop had before its timing became a part of its own; files and options may still use them."""

from collections.abc import Mapping
from typing import Any

from laploop.errors import InvalidValueError

Plain = dict[str, Any]

_OPTIONS = {
    "--loop.latency": "--loop.timing.service",
    "--loop.transfer-ms": "--loop.timing.transfer.latency-ms",
}
_PHYSICS_HZ = 500.0
"""Where a file does not say otherwise."""


def present_option(name: str) -> str:
    """Return an option's present name; most have no other."""
    for earlier, present in _OPTIONS.items():
        if name == earlier or name.startswith(f"{earlier}."):
            return present + name.removeprefix(earlier)
    return name


def with_present_names(loop: Mapping[str, Any]) -> Plain:
    """Return what a file holds of a loop under the present names.

    `latency` is now `timing.service`, `transfer_ms` a constant `timing.transfer`, and the delays of proprioception are given in
    milliseconds instead of physics steps.

    Raises:
        InvalidValueError: If a value stands under its earlier and its present name.
    """
    found = dict(loop)
    if "latency" in found:
        _put(found, ("timing", "service"), "latency", found.pop("latency"))
    if "transfer_ms" in found:
        transfer = {"kind": "constant", "latency_ms": found.pop("transfer_ms")}
        _put(found, ("timing", "transfer"), "transfer_ms", transfer)
    steps = found.get("proprioception")
    for channel in ("kinematics", "force"):
        earlier = f"{channel}_delay_steps"
        if isinstance(steps, Mapping) and isinstance(steps.get(earlier), int):
            rest = {name: value for name, value in found["proprioception"].items() if name != earlier}
            delay_ms = steps[earlier] * 1e3 / found.get("physics_hz", _PHYSICS_HZ)
            found["proprioception"] = rest
            _put(found, ("proprioception", f"{channel}_delay_ms"), f"proprioception.{earlier}", delay_ms)
    return found


def _put(loop: Plain, path: tuple[str, str], earlier: str, value: Any) -> None:
    table, name = path
    there = loop.get(table, {})
    if not isinstance(there, Mapping) or name in there:
        raise InvalidValueError(f"loop.{earlier}", value, f"none beside loop.{table}.{name}, its present name")
    loop[table] = {**there, name: value}
