"""The table of a depth evaluation: scores of the models against each truth."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.bootstrap import UNKNOWN, Bounded
from laploop.perception.messages import DepthEstimate
from laploop.perception.metrics import DepthMetrics, MetricsInterval
from laploop.perception.reliability import TENTHS, CalibrationBin
from laploop.perception.slip_calibration import SLIP_EDGES, SlipCalibration

AGAINST = {
    "zivid": "the reference camera's reprojected depth, over all pixels of its validity mask",
    "exact-at-zivid": "exact depth, over the same pixels",
    "exact": "exact depth, over all pixels in the range of depth",
}
"""What a row is measured against, and over which pixels."""

REFERENCE_ROW = "reference"
"""The reference camera itself, measured against exact depth."""

BOUNDED = ("lit_valid_share", "phase_valid_share", "phase_valid_mae_mm")
"""Measures of a row that are ratios of two sums."""

COVERAGES = np.arange(1, TENTHS + 1) / TENTHS
"""Fractions of the pixels, admitted by falling confidence, at which the error is given."""

_INTERVALS = tuple(metric.name for metric in fields(DepthMetrics) if metric.name not in {"pixels", "bias_mm"})


@dataclass(frozen=True, kw_only=True)
class DepthRow:
    """One line of the table."""

    model: str
    against: str
    """One of `AGAINST`."""
    working_distance_mm: str
    """A bin, or `all`."""
    frames: int
    valid_fraction: float
    """Fraction of the pixels that count that the model marks valid."""
    every: DepthMetrics
    """Over every pixel that counts, whether the model marks it valid or not."""
    every_interval: MetricsInterval
    valid: DepthMetrics
    """Over those that the model marks valid."""
    valid_interval: MetricsInterval
    lit_fraction: float
    """Fraction of the pixels that count that the projector reaches, in the range of depth; 0 where nobody knows them."""
    lit: DepthMetrics
    """Over those, whether the model marks them valid or not."""
    lit_interval: MetricsInterval
    family: str = "all"
    """A family of shapes, or `all`."""
    texture: str = "all"
    """A kind of texture, or `all`."""
    lit_valid_share: Bounded = UNKNOWN
    """Fraction of the lit pixels that the model marks valid; unknown where nobody knows them."""
    phase_valid_share: Bounded = UNKNOWN
    """Fraction of the pixels that count that `phase` marks valid; unknown where it was not evaluated."""
    phase_valid_mae_mm: Bounded = UNKNOWN
    """Mean absolute error over those, whether the model marks them valid or not: the same pixels for all models."""
    note: str = ""
    """Remark on this line."""

    def flat(self) -> dict[str, object]:
        """Return the line as a flat dictionary.

        Metrics over the pixels that the model marks valid have the prefix `valid_`, over those that the projector reaches
        `lit_`. `lit_valid_share` and those with `phase_valid_` are as above. `_low` and `_high` are the ends of the 95 %
        interval; what is unknown is None.
        """
        line: dict[str, object] = {
            "model": self.model,
            "against": self.against,
            "working_distance_mm": self.working_distance_mm,
            "frames": self.frames,
        }
        line.update(_with_interval("", self.every, self.every_interval))
        line["valid_share"] = self.valid_fraction
        line.update(_with_interval("valid_", self.valid, self.valid_interval))
        line["lit_share"] = self.lit_fraction
        line.update(_with_interval("lit_", self.lit, self.lit_interval))
        for name in BOUNDED:
            line.update(_flat_bounded(name, getattr(self, name)))
        line["family"], line["texture"] = self.family, self.texture
        line["note"] = self.note
        # A bin without pixels has no error.
        return {name: _known(value) if isinstance(value, float) else value for name, value in line.items()}


@dataclass(frozen=True, kw_only=True)
class ReliabilityRow:
    """Whether the confidence of one model tells good pixels from bad ones, as `perception/reliability.py` measures it."""

    model: str
    against: str
    """One of `AGAINST`."""
    family: str
    """A family of shapes, or `all`."""
    aurc_mm: Bounded
    calibration_error: Bounded
    risk_mm: tuple[float, ...]
    """Mean absolute error of the most confident pixels at `COVERAGES`."""
    tenths: tuple[CalibrationBin, ...]
    """Predicted and seen rate within 1 mm by tenths of the confidence."""
    slips: SlipCalibration | None = None
    """Predicted and seen slips, of models that foresee them."""

    def flat(self) -> dict[str, object]:
        """Return the row as JSON has it; `_low` and `_high` are the ends of the 95 % interval, what is unknown is None."""
        return {
            "model": self.model,
            "against": self.against,
            "family": self.family,
            **_flat_bounded("aurc_mm", self.aurc_mm),
            **_flat_bounded("calibration_error", self.calibration_error),
            "coverage": COVERAGES.tolist(),
            "risk_mm": [_known(risk) for risk in self.risk_mm],
            "tenths": [_flat_bin(part) for part in self.tenths],
            "slips": None if self.slips is None else _flat_slips(self.slips),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthExample:
    """One frame with what every model made of it, for the figures; all arrays are (height, width)."""

    index: int
    """Of the frame in the data set."""
    against: str
    image: NDArray[np.uint8]
    truth_mm: NDArray[np.float32]
    """What the models are measured against."""
    mask: NDArray[np.bool_]
    """Where it counts."""
    estimates: Mapping[str, DepthEstimate]
    """By model, in the order of the table."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthTable:
    """What an evaluation found."""

    dataset: str
    config: Any
    """The evaluation's configuration, a dataclass."""
    tissues: int
    frames: int
    rows: tuple[DepthRow, ...]
    median_ms: Mapping[str, float]
    """Time of one estimate, by model."""
    examples: tuple[DepthExample, ...] = ()
    family_rows: tuple[DepthRow, ...] = ()
    """Lines of the families of shapes, where the data set has more than one."""
    texture_rows: tuple[DepthRow, ...] = ()
    """Lines of the kinds of texture, where the data set has more than one."""
    reliability: tuple[ReliabilityRow, ...] = ()
    """Of the models that have a confidence: of all frames, and of families where the data set has more than one."""

    def row(self, model: str, working_distance_mm: str = "all", *, against: str | None = None) -> DepthRow:
        """Return one line; without `against`, the first that fits.

        Raises:
            InvalidValueError: If there is none.
        """
        for row in self.rows:
            if (row.model, row.working_distance_mm) == (model, working_distance_mm) and against in {None, row.against}:
                return row
        known = sorted({(row.model, row.working_distance_mm, row.against) for row in self.rows})
        raise InvalidValueError("row", (model, working_distance_mm, against), f"one of {known}")

    def models(self, against: str) -> list[str]:
        """Return which models have rows against something, in the order of the table."""
        return list(dict.fromkeys(row.model for row in self.rows if row.against == against))

    def flat_rows(self) -> list[dict[str, object]]:
        """Return all lines as flat dictionaries."""
        return [row.flat() for row in self.rows]

    def flat_family_rows(self) -> list[dict[str, object]]:
        """Return the lines of the families as flat dictionaries."""
        return [row.flat() for row in self.family_rows]

    def flat_texture_rows(self) -> list[dict[str, object]]:
        """Return the lines of the textures as flat dictionaries."""
        return [row.flat() for row in self.texture_rows]

    def reliability_rows(self) -> list[dict[str, object]]:
        """Return the rows of the models with a confidence as flat dictionaries."""
        return [row.flat() for row in self.reliability]

    def error_budget(self) -> dict[str, object] | None:
        """Say how much of the error against the reference camera is the reference's own; None without such rows.

        `reference_mae_mm` is calibration, reprojection and the reference camera together: its depth against exact depth at its
        own pixels. `models` gives for each model its error against the reference, and against exact depth at the same pixels,
        which is the model's own part. Absolute errors do not add up: the whole is at most the sum of the two.
        """
        by_key = {(row.model, row.against): row for row in self.rows if row.working_distance_mm == "all"}
        reference = by_key.get((REFERENCE_ROW, "exact-at-zivid"))
        if reference is None:
            return None
        models = {
            model: {
                "against_zivid_mae_mm": row.every.mae_mm,
                "against_exact_mae_mm": by_key[model, "exact-at-zivid"].every.mae_mm,
            }
            for (model, against), row in by_key.items()
            if against == "zivid" and (model, "exact-at-zivid") in by_key
        }
        return {
            "reference_mae_mm": reference.every.mae_mm,
            "reference_rmse_mm": reference.every.rmse_mm,
            "reference_bias_mm": reference.every.bias_mm,
            "models": models,
        }


def _known(value: float) -> float | None:
    """Return a number, or None for NaN, which neither JSON nor a spreadsheet knows."""
    return None if math.isnan(value) else value


def _with_interval(prefix: str, metrics: DepthMetrics, interval: MetricsInterval) -> dict[str, object]:
    line: dict[str, object] = {f"{prefix}{name}": value for name, value in asdict(metrics).items()}
    for name in _INTERVALS:
        line[f"{prefix}{name}_low"] = getattr(interval.low, name)
        line[f"{prefix}{name}_high"] = getattr(interval.high, name)
    return line


def _flat_bin(part: CalibrationBin) -> dict[str, object]:
    return {"pixels": part.pixels, "predicted": _known(part.predicted), "seen": _known(part.seen)}


def _flat_slips(slips: SlipCalibration) -> dict[str, object]:
    return {
        "edges": list(SLIP_EDGES),
        "bins": [_flat_bin(part) for part in slips.bins],
        "all": _flat_bin(slips.every) | _flat_bounded("seen", slips.every_seen),
        "valid": _flat_bin(slips.valid) | _flat_bounded("seen", slips.valid_seen),
    }


def _flat_bounded(name: str, measure: Bounded) -> dict[str, object]:
    return {name: _known(measure.value), f"{name}_low": _known(measure.low), f"{name}_high": _known(measure.high)}
