"""What a task measures over many episodes, and what of it is required."""

from dataclasses import dataclass
from typing import Literal

Statistic = Literal["mean", "rms", "max", "min"]
"""How the episodes' values become one."""


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """One number of many episodes, and its bound, if it has one."""

    name: str
    column: str
    """Of an episode: `success`, `final_error_mm`, ..., or one of the task's metrics."""
    unit: str = ""
    statistic: Statistic = "max"
    at_most: float | None = None
    at_least: float | None = None

    def bar(self) -> str:
        """Return the bound in words; empty without one."""
        unit = f" {self.unit}" if self.unit else ""
        if self.at_most is not None:
            return f"at most {self.at_most:.3g}{unit}"
        return "" if self.at_least is None else f"at least {self.at_least:.3g}{unit}"
