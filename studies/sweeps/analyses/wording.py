"""Numbers and quantities as sentences and tables have them."""

from laploop.studies.sweeps.bootstrap import Estimate


def quantity(label: str) -> tuple[str, str]:
    """Return the name in a label such as `RMS error [mm]`, and its unit with a space before it, or nothing without a unit."""
    name, bracket, unit = label.partition(" [")
    return name, f" {unit.removesuffix(']')}" if bracket else ""


def spread(found: Estimate, sign: str = "") -> str:
    """Return a mean with its interval, three digits each."""
    return f"{found.mean:{sign}.3g} [{found.low:{sign}.3g}, {found.high:{sign}.3g}]"


def listed(words: list[str]) -> str:
    """Return words as a sentence lists them."""
    return " and ".join(filter(None, (", ".join(words[:-1]), *words[-1:])))
