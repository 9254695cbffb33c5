"""What a figure shows, apart from how it is drawn: the same charts become PNGs and parts of the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from laploop.studies.sweeps.bootstrap import Estimate


@dataclass(frozen=True, kw_only=True)
class Series:
    """Values over a quantity or over named categories."""

    name: str
    x: Sequence[float] | Sequence[str]
    y: Sequence[float]
    low: Sequence[float] | None = None
    """Lower ends of the intervals."""
    high: Sequence[float] | None = None
    base: Sequence[float] | None = None
    """Where bars begin; 0 if not given."""
    kind: Literal["measured", "theory"] = "measured"
    """Theory is drawn as a line without marks."""

    @classmethod
    def of(cls, name: str, points: Sequence[tuple[Any, Estimate | None]]) -> "Series":
        """Make a series of those estimates that there are, over numbers or names."""
        known = [(x, one) for x, one in points if one is not None]
        return cls(
            name=name,
            x=[x for x, _ in known],
            y=[one.mean for _, one in known],
            low=[one.low for _, one in known],
            high=[one.high for _, one in known],
        )


@dataclass(frozen=True, kw_only=True)
class Chart:
    """One figure."""

    name: str
    """Of its file, without the ending."""
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    kind: Literal["lines", "bars"] = "lines"
    note: str = ""
    """How to read it."""

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "Chart":
        """Return the chart that `dataclasses.asdict` made plain."""
        return cls(**{**plain, "series": tuple(Series(**series) for series in plain["series"])})
