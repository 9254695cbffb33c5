"""A filter together with how well it has done lately: the grounds for trusting it."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

from laploop.control.prediction.harmonic_filter import HarmonicFilter

_NIS_MEMORY = 8
"""Measurements over which the recent normalised innovation squared is averaged."""
_CONSISTENT_NIS = 2.5
"""An average that a filter which is right about itself exceeds once in a hundred measurements."""
_MAX_NIS = 10.0


@dataclass(frozen=True, kw_only=True)
class _Forecast:
    due_ns: int
    value: float
    held: float
    """What was measured when the forecast was made."""


class FilterConsistency:
    """Feeds a filter and keeps, over a window of measurements, its innovations and the errors of its forecasts.

    With every measurement a forecast is made for a fixed time ahead. When that time has come it is compared with the
    measurements (interpolated), and so is the alternative of holding the measurement on which it was made.
    """

    def __init__(self, filtered: HarmonicFilter, *, horizon_ns: int, window: int) -> None:
        self.filter = filtered
        self._horizon_ns = horizon_ns
        self._pending: deque[_Forecast] = deque()
        self._nis: deque[float] = deque(maxlen=window)
        self._forecast_squares: deque[float] = deque(maxlen=window)
        self._held_squares: deque[float] = deque(maxlen=window)
        self._last: tuple[int, float] | None = None
        self._recent_nis = 1.0

    @property
    def forecasts(self) -> int:
        """Number of forecasts in the record."""
        return len(self._forecast_squares)

    @property
    def mean_nis(self) -> float:
        """Mean normalised innovation squared; 1 for a filter that is right about itself, infinite before the first."""
        return _mean(self._nis)

    @property
    def forecast_variance(self) -> float:
        """Mean squared error of the forecasts in square metres, the measurement's noise included; infinite without any."""
        return _mean(self._forecast_squares)

    @property
    def held_variance(self) -> float:
        """The same of holding the newest measurement; its noise counts twice."""
        return _mean(self._held_squares)

    def recent_forecast_variance(self, count: int) -> float:
        """Return the mean squared error of the last `count` forecasts."""
        return _mean(islice(reversed(self._forecast_squares), count))

    def advance(self, time_ns: int) -> None:
        """Carry the filter on to a later time, with more process noise after large innovations.

        Something that its random walks do not allow for (tissue pushed slowly, a rhythm that changes) is taken up within
        seconds that way, at the price of more noise in the meantime.
        """
        consistent = self._recent_nis <= _CONSISTENT_NIS
        self.filter.advance(time_ns, process_noise_scale=1.0 if consistent else min(self._recent_nis, _MAX_NIS) ** 2)

    def correct(self, measured: float) -> None:
        """Take in a measurement made at the filter's time: settle what is due, correct the filter, forecast anew."""
        now_ns = self.filter.time_ns
        if self._last is not None:
            last_ns, last = self._last
            while self._pending and self._pending[0].due_ns <= now_ns:
                forecast = self._pending.popleft()
                if forecast.due_ns >= last_ns:
                    fraction = (forecast.due_ns - last_ns) / (now_ns - last_ns)
                    came = last + fraction * (measured - last)
                    self._forecast_squares.append((forecast.value - came) ** 2)
                    self._held_squares.append((forecast.held - came) ** 2)
        nis = self.filter.correct(measured)
        self._nis.append(nis)
        self._recent_nis += (nis - self._recent_nis) / _NIS_MEMORY
        self._last = now_ns, measured
        due_ns = now_ns + self._horizon_ns
        self._pending.append(_Forecast(due_ns=due_ns, value=self.filter.value_at(due_ns), held=measured))

    def shift(self, step: float, sigma: float) -> None:
        """Move the bias by a step known to a standard deviation, and start the record anew."""
        self.filter.shift(step, sigma)
        self._pending.clear()
        for record in (self._nis, self._forecast_squares, self._held_squares):
            record.clear()
        self._last = None
        self._recent_nis = 1.0


def _mean(numbers: Iterable[float]) -> float:
    kept = list(numbers)
    return math.fsum(kept) / len(kept) if kept else math.inf
