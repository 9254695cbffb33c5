"""A filter together with how well it has done lately: the grounds for trusting it."""

from collections import deque
from dataclasses import dataclass

from laploop.control.prediction.harmonic_filter import HarmonicFilter
from laploop.control.prediction.recent_mean import RecentMean

_INNOVATION_MEMORY = 8
"""Measurements over which recent innovation, the normalised innovation squared, is averaged."""
_ALARM = 2.5
"""An average that a filter which is right about itself exceeds once in a hundred measurements."""
_MAX_INNOVATION = 10.0


@dataclass(frozen=True, kw_only=True)
class _Forecast:
    due_ns: int
    value: float
    held: float
    """What was measured when the forecast was made."""


class FilterConsistency:
    """Feeds a filter and keeps, over a window of measurements, its innovations and its forecasts beside what came.

    With every measurement a forecast is made for a fixed time ahead. When that time has come it is compared with the
    measurements (interpolated), and so is the alternative of holding the measurement on which it was made.
    """

    def __init__(self, filtered: HarmonicFilter, *, horizon_ns: int, window: int) -> None:
        """Start an empty record of a filter."""
        self.filter = filtered
        self._horizon_ns = horizon_ns
        self._pending: deque[_Forecast] = deque()
        self._nis = RecentMean(window)
        self._forecast_squares = RecentMean(window)
        self._held_squares = RecentMean(window)
        self._last: tuple[int, float] | None = None
        self._innovation = 1.0

    @property
    def forecasts(self) -> int:
        """Number of forecasts in the record."""
        return len(self._forecast_squares)

    @property
    def mean_nis(self) -> float:
        """Mean normalised innovation squared; 1 for a filter that is right about itself."""
        return self._nis.mean

    @property
    def forecast_variance(self) -> float:
        """Mean squared error of the forecasts in square metres, the measurement's noise included."""
        return self._forecast_squares.mean

    def recent_forecast_variance(self, count: int) -> float:
        """Return the mean squared error of the last so many forecasts."""
        return self._forecast_squares.mean_of_last(count)

    @property
    def held_variance(self) -> float:
        """The same of holding the newest measurement; its noise counts twice."""
        return self._held_squares.mean

    def advance(self, time_ns: int) -> None:
        """Carry the filter on to a later time, the more freely the more it has been surprised lately.

        Something that its random walks do not allow for (tissue pushed slowly, a rhythm that changes) is taken up within
        seconds that way, at the price of more noise in the meantime.
        """
        calm = self._innovation <= _ALARM
        self.filter.advance(time_ns, process_noise_scale=1.0 if calm else min(self._innovation, _MAX_INNOVATION) ** 2)

    def correct(self, measured: float) -> None:
        """Take in a measurement made at the filter's time: settle what is due, correct the filter, forecast anew."""
        now_ns = self.filter.time_ns
        if self._last is not None:
            last_ns, last = self._last
            while self._pending and self._pending[0].due_ns <= now_ns:
                forecast = self._pending.popleft()
                if forecast.due_ns >= last_ns:
                    share = (forecast.due_ns - last_ns) / (now_ns - last_ns)
                    came = last + share * (measured - last)
                    self._forecast_squares.append((forecast.value - came) ** 2)
                    self._held_squares.append((forecast.held - came) ** 2)
        nis = self.filter.correct(measured)
        self._nis.append(nis)
        self._innovation += (nis - self._innovation) / _INNOVATION_MEMORY
        self._last = now_ns, measured
        due_ns = now_ns + self._horizon_ns
        self._pending.append(_Forecast(due_ns=due_ns, value=self.filter.value_at(due_ns), held=measured))

    def shift(self, step: float, sigma: float) -> None:
        """Move the bias by a step known to a standard deviation; what was recorded before it says nothing any more."""
        self.filter.shift(step, sigma)
        self._pending.clear()
        for record in (self._nis, self._forecast_squares, self._held_squares):
            record.clear()
        self._last = None
        self._innovation = 1.0
