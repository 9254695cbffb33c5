"""How far tissue has moved along the viewing direction, and how fast, from noisy measurements at known times."""

from dataclasses import dataclass

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class AlphaBetaFilterConfig:
    """Gains of an alpha-beta filter and its rejection of outliers."""

    alpha: float = 0.7
    """Share of a measurement's innovation that corrects the displacement."""
    beta: float = 0.25
    """Share that, divided by the time since the last measurement, corrects the rate."""
    max_jump_m: float = 0.006
    """A measurement farther than this from what is expected is not believed at once."""
    persistence: int = 3
    """So many measurements in a row that disagree with what is expected, but not with each other, are believed."""
    max_rate_mps: float = 0.04
    """Bound of the rate: breathing of 25 mm at 0.5 Hz."""
    max_extrapolation_s: float = 0.15
    """How far beyond its last measurement the rate is believed."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("alpha", "beta"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InvalidValueError(name, getattr(self, name), "0 to 1")
        for name in ("max_jump_m", "max_rate_mps"):
            if not getattr(self, name) > 0.0:
                raise InvalidValueError(name, getattr(self, name), "above 0")
        if self.persistence < 1:
            raise InvalidValueError("persistence", self.persistence, "an integer from 1")
        if self.max_extrapolation_s < 0.0:
            raise InvalidValueError("max_extrapolation_s", self.max_extrapolation_s, "0 or more")


class AlphaBetaFilter:
    """An alpha-beta filter of one displacement; it starts from zero at rest."""

    def __init__(self, config: AlphaBetaFilterConfig, start_ns: int) -> None:
        """Start at displacement 0, at the time of the reference."""
        self._config = config
        self._time_ns = start_ns
        self._displacement = 0.0
        self._rate = 0.0
        self._doubtful: list[float] = []

    @property
    def measured_ns(self) -> int:
        """Time of the last measurement that was believed."""
        return self._time_ns

    def rate_at(self, time_ns: int) -> float:
        """Return the rate in m/s; zero once the time is too far from the last measurement to believe it."""
        recent = (time_ns - self._time_ns) * 1e-9 <= self._config.max_extrapolation_s
        return self._rate if recent else 0.0

    def displacement_at(self, time_ns: int) -> float:
        """Return the displacement in metres, extrapolated from the last measurement as far as that is believed."""
        ahead = min(max(time_ns - self._time_ns, 0) * 1e-9, self._config.max_extrapolation_s)
        return self._displacement + ahead * self._rate

    def update(self, measured: float, time_ns: int) -> bool:
        """Take in a displacement in metres, measured at a time after the last one; say whether it is believed."""
        elapsed = (time_ns - self._time_ns) * 1e-9
        if elapsed <= 0.0:
            return False
        expected = self.displacement_at(time_ns)
        innovation = measured - expected
        if abs(innovation) > self._config.max_jump_m:
            return self._doubt(measured, time_ns)
        self._doubtful.clear()
        limit = self._config.max_rate_mps
        self._displacement = expected + self._config.alpha * innovation
        self._rate = min(max(self._rate + self._config.beta * innovation / elapsed, -limit), limit)
        self._time_ns = time_ns
        return True

    def _doubt(self, measured: float, time_ns: int) -> bool:
        if self._doubtful and abs(measured - self._doubtful[-1]) > self._config.max_jump_m:
            self._doubtful.clear()
        self._doubtful.append(measured)
        if len(self._doubtful) < self._config.persistence:
            return False
        self._doubtful.clear()
        self._displacement, self._rate, self._time_ns = measured, 0.0, time_ns
        return True
