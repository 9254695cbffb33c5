"""How far tissue has moved along a direction, and how fast, from noisy measurements at known times."""

import math
from typing import Annotated, Any

from laploop.configuration import Field, configuration, from_plain
from laploop.control.prediction.motion_predictor import Prediction


@configuration
class AlphaBetaFilterConfig:
    """Gains of an alpha-beta filter and its rejection of outliers."""

    alpha: Annotated[float, Field(ge=0.0, le=1.0)] = 0.7
    """Fraction of a measurement's innovation that corrects the displacement."""
    beta: Annotated[float, Field(ge=0.0, le=1.0)] = 0.25
    """Fraction that, divided by the time since the last measurement, corrects the rate."""
    max_jump_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.006
    """Largest innovation that is accepted at once."""
    persistence: Annotated[int, Field(ge=1, le=100)] = 3
    """Number of consecutive outliers that are accepted after all if they agree with each other."""
    max_rate_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.04
    """Bound of the rate: breathing of 25 mm at 0.5 Hz."""
    max_extrapolation_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.15
    """How long after its last measurement the rate is used."""


class AlphaBetaFilter:
    """An alpha-beta filter of one displacement; a `MotionPredictor` that goes on at the rate measured last."""

    def __init__(self, config: AlphaBetaFilterConfig | None = None) -> None:
        self._config = config or AlphaBetaFilterConfig()
        self.reset()

    @classmethod
    def of(cls, **fields: Any) -> "AlphaBetaFilter":
        """Make a filter from the fields of its configuration."""
        return cls(from_plain(AlphaBetaFilterConfig, fields))

    def reset(self) -> None:
        """Forget everything."""
        self._time_ns: int | None = None
        self._displacement = 0.0
        self._rate = 0.0
        self._outliers: list[float] = []

    @property
    def measured_ns(self) -> int:
        """Time of the last measurement that was accepted; -1 before the first."""
        return -1 if self._time_ns is None else self._time_ns

    def rate_at(self, time_ns: int) -> float:
        """Return the rate in m/s; zero once the last measurement is too old."""
        recent = (time_ns - self.measured_ns) * 1e-9 <= self._config.max_extrapolation_s
        return self._rate if recent else 0.0

    def displacement_at(self, time_ns: int) -> float:
        """Return the displacement in metres, extrapolated from the last measurement for a limited time."""
        ahead = min(max(time_ns - self.measured_ns, 0) * 1e-9, self._config.max_extrapolation_s)
        return self._displacement + ahead * self._rate

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Take in a displacement in metres that is newer than the last; return whether it is accepted."""
        if measured is None or not math.isfinite(measured):
            return False
        if self._time_ns is None:
            return self._restart(measured, captured_ns)
        elapsed = (captured_ns - self._time_ns) * 1e-9
        if elapsed <= 0.0:
            return False
        expected = self.displacement_at(captured_ns)
        innovation = measured - expected
        if abs(innovation) > self._config.max_jump_m:
            return self._is_persistent(measured) and self._restart(measured, captured_ns)
        self._outliers.clear()
        limit = self._config.max_rate_mps
        self._displacement = expected + self._config.alpha * innovation
        self._rate = min(max(self._rate + self._config.beta * innovation / elapsed, -limit), limit)
        self._time_ns = captured_ns
        return True

    def predict(self, at_ns: int) -> Prediction:
        """Return displacement and rate at a time; they are never marked as trusted."""
        return Prediction(value=self.displacement_at(at_ns), velocity=self.rate_at(at_ns), trusted=False)

    def _restart(self, measured: float, captured_ns: int) -> bool:
        self._outliers.clear()
        self._displacement, self._rate, self._time_ns = measured, 0.0, captured_ns
        return True

    def _is_persistent(self, outlier: float) -> bool:
        if self._outliers and abs(outlier - self._outliers[-1]) > self._config.max_jump_m:
            self._outliers.clear()
        self._outliers.append(outlier)
        return len(self._outliers) >= self._config.persistence


class HeldMeasurement(AlphaBetaFilter):
    """The predictor that does not predict: the newest measurement, as it stands."""

    def __init__(self) -> None:
        super().__init__(AlphaBetaFilterConfig(alpha=1.0, beta=0.0, max_extrapolation_s=0.0))
