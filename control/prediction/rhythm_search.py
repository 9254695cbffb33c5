"""Find the frequencies of up to two rhythms, and all their phasors, in the last seconds of a signal."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.prediction.harmonic_model import HarmonicModel, harmonic_model
from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import InvalidValueError


@configuration
class RhythmBand:
    """Where a rhythm is looked for."""

    lowest_hz: Annotated[float, Field(ge=0.02, le=10.0)]
    """Lowest frequency of its fundamental."""
    highest_hz: Annotated[float, Field(ge=0.02, le=10.0)]
    """Highest frequency of its fundamental."""
    harmonics: Annotated[int, Field(ge=1, le=6)]
    """Number of harmonics, the fundamental included."""
    step_hz: Annotated[float, Field(ge=0.002, le=1.0)]
    """Spacing of the frequencies that are tried before the best is refined."""

    def __post_init__(self) -> None:
        if self.highest_hz < self.lowest_hz:
            raise InvalidValueError("highest_hz", self.highest_hz, f"at least lowest_hz ({self.lowest_hz})")

    def candidates(self) -> Array:
        """Return the frequencies to try, in Hz."""
        count = math.ceil((self.highest_hz - self.lowest_hz) / self.step_hz) + 1
        return np.linspace(self.lowest_hz, self.highest_hz, count)

    def bounds_rad_s(self) -> tuple[float, float]:
        """Return how far a rhythm may drift, as angular frequencies: a tenth beyond the band."""
        return 2.0 * math.pi * 0.9 * self.lowest_hz, 2.0 * math.pi * 1.1 * self.highest_hz


RESPIRATION = RhythmBand(lowest_hz=0.1, highest_hz=0.6, harmonics=3, step_hz=0.02)
HEARTBEAT = RhythmBand(lowest_hz=0.7, highest_hz=2.5, harmonics=2, step_hz=0.04)


@configuration
class RhythmSearchConfig:
    """What is looked for, and how much signal that takes."""

    bands: tuple[RhythmBand, ...] = (RESPIRATION, HEARTBEAT)
    """Respiration and heartbeat, slow before fast."""
    span_s: Annotated[float, Field(ge=0.5, le=1000.0)] = 10.0
    """Length of signal that is looked at, at most."""
    min_span_s: Annotated[float, Field(ge=0.5, le=1000.0)] = 3.0
    """Length of signal before which no search begins."""
    min_periods: Annotated[float, Field(ge=0.5, le=10.0)] = 0.9
    """Minimum number of periods observed before a rhythm is accepted."""
    significance: Annotated[float, Field(ge=1.0, le=1000.0)] = 10.0
    """Least ratio of the power a rhythm explains to the power left, each per degree of freedom."""
    min_amplitude_m: Annotated[float, Field(ge=0.0, le=0.01)] = 0.00005
    """Amplitude below which a rhythm is left out."""
    chunk: Annotated[int, Field(ge=1, le=1000)] = 5
    """Number of frequencies tried in one slice of the search."""

    def __post_init__(self) -> None:
        if self.min_span_s > self.span_s:
            raise InvalidValueError("min_span_s", self.min_span_s, f"at most span_s ({self.span_s})")
        if any(slow.highest_hz >= fast.lowest_hz for slow, fast in pairwise(self.bands)):
            shown = [(band.lowest_hz, band.highest_hz) for band in self.bands]
            raise InvalidValueError("bands", shown, "bands in rising order that do not overlap")


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """The rhythms found in a window, as a state of their model with its covariance."""

    model: HarmonicModel
    time_ns: int
    """Of the state: the end of the window."""
    state: Array
    covariance: Array
    bounds_rad_s: Array
    """(rhythms, 2)."""
    residual_m: float
    """Root mean square of what the rhythms do not explain."""


class RhythmSearch:
    """A search that is done in slices, so that no call takes long; it starts over when it is done.

    Band by band, least squares at each frequency of a grid tell how much of what is left its harmonics explain. The best
    one is refined together with the rhythms already found by Gauss-Newton steps on all phasors and frequencies. A rhythm's
    fundamental must be its strongest harmonic, which keeps subharmonics and strangers out.
    """

    def __init__(self, config: RhythmSearchConfig, window: SampleWindow) -> None:
        """Take the window, which others fill."""
        self._config = config
        self._window = window
        self._slices: Iterator[Hypothesis | None]
        self._signal: tuple[int, Array, Array] | None
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: a search under way is its signal and the number of slices done."""
        return {name: value for name, value in vars(self).items() if name != "_slices"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._slices = iter(()) if self._signal is None else self._search(*self._signal)
        for _ in range(self._done):
            next(self._slices)

    def reset(self) -> None:
        """Give up what was begun."""
        self._slices = iter(())
        self._signal = None
        self._done = 0

    def step(self) -> Hypothesis | None:
        """Do one slice; return what was found if that was the last one."""
        if self._window.covered_s < self._config.min_span_s:
            return None
        self._done += 1
        try:
            return next(self._slices)
        except StopIteration:
            self._signal, self._done = self._window.snapshot(), 1
            self._slices = self._search(*self._signal)
            return next(self._slices)

    def _search(self, time_ns: int, seconds: Array, values: Array) -> Iterator[Hypothesis | None]:
        """Search; yield None after each slice but the last, then what is found."""
        found: tuple[tuple[RhythmBand, float], ...] = ()
        fit = _refined((), seconds, values)
        for band in self._config.bands:
            left = values - fit.values
            best_hz, best_power = 0.0, math.inf
            candidates = band.candidates()
            candidates = candidates[candidates * -seconds[0] >= self._config.min_periods]
            for start in range(0, len(candidates), self._config.chunk):
                tried_hz = candidates[start : start + self._config.chunk]
                powers = _power_left(tried_hz, band.harmonics, seconds, left)
                index = int(np.argmin(powers))
                if powers[index] < best_power:
                    best_hz, best_power = float(tried_hz[index]), float(powers[index])
                yield None
            if not math.isfinite(best_power):
                continue
            tried = (*found, (band, 2.0 * math.pi * best_hz))
            trial = fit
            for _ in range(3):
                trial = _refined(tried, seconds, values)
                tried = tuple((one, float(rate)) for (one, _), rate in zip(tried, trial.rates, strict=True))
                yield None
            if self._is_convincing(fit, trial, len(values)):
                found, fit = tried, trial
        yield Hypothesis(
            model=fit.model,
            time_ns=time_ns,
            state=fit.state,
            covariance=fit.covariance,
            bounds_rad_s=_bounds(found),
            residual_m=math.sqrt(fit.power / len(values)),
        )

    def _is_convincing(self, without: "_Fit", fit: "_Fit", count: int) -> bool:
        """Return whether the last rhythm of a fit is worth its parameters, strong enough, and led by its fundamental."""
        more = fit.model.size - without.model.size
        spare = max(count - fit.model.size, 1)
        explained = (without.power - fit.power) / more
        strengths = np.abs(fit.model.phasors(fit.state))[fit.model.rhythm == len(fit.model.harmonics) - 1]
        return bool(
            explained > self._config.significance * fit.power / spare
            and strengths[0] >= self._config.min_amplitude_m
            and strengths[0] >= strengths.max()
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    model: HarmonicModel
    state: Array
    covariance: Array
    values: Array
    """What the state says of the samples."""
    power: float
    """Sum of squares of what it leaves."""

    @property
    def rates(self) -> Array:
        return np.asarray(self.state[self.model.rates])


_PRIOR_AMPLITUDE_M = 0.01
_PRIOR_BIAS_M = 10.0
_PRIOR_FREQUENCY = 0.15
"""Relative; a Gauss-Newton step cannot go far beyond the spacing of the grid."""
_MIN_NOISE_M = 2e-5


def _bounds(rhythms: tuple[tuple[RhythmBand, float], ...]) -> Array:
    return np.array([band.bounds_rad_s() for band, _ in rhythms]).reshape(-1, 2)


def _power_left(candidates_hz: Array, harmonics: int, seconds: Array, values: Array) -> Array:
    """Return the sum of squares left after least squares of each frequency's harmonics and a bias, (candidates,).

    It is infinite where the fundamental is not the strongest harmonic: there the true frequency is a multiple.
    """
    model = harmonic_model((harmonics,))
    basis = np.delete(model.basis(model.turns(2.0 * math.pi * candidates_hz[:, None], seconds)), model.rates, axis=-1)
    gram = basis.swapaxes(1, 2) @ basis
    projected = values @ basis
    # A little of the diagonal keeps short windows solvable.
    gram += 1e-6 * gram * np.eye(gram.shape[-1])
    solved = np.linalg.solve(gram, projected[..., None])[..., 0]
    strengths = np.hypot(solved[:, 1::2], solved[:, 2::2])
    left = values @ values - (projected * solved).sum(axis=1)
    return np.where(strengths[:, 0] >= strengths.max(axis=1), left, np.inf)


def _refined(rhythms: tuple[tuple[RhythmBand, float], ...], seconds: Array, values: Array) -> _Fit:
    """Fit bias and phasors at given angular frequencies, then make one Gauss-Newton step on everything."""
    model = harmonic_model(tuple(band.harmonics for band, _ in rhythms))
    state, precision = np.zeros(model.size), np.full(model.size, _PRIOR_AMPLITUDE_M**-2)
    state[model.rates] = [rate for _, rate in rhythms]
    precision[0] = _PRIOR_BIAS_M**-2
    precision[model.rates] = (_PRIOR_FREQUENCY * state[model.rates]) ** -2.0
    variance = 1e-6
    linear = np.ones(model.size, dtype=bool)
    linear[model.rates] = False
    basis = model.basis(model.turns(state[model.rates], seconds))[:, linear]
    state[linear] = np.linalg.solve(basis.T @ basis + np.diag(precision[linear] * variance), basis.T @ values)
    fitted, jacobian = model.linearised(state, seconds)
    normal = jacobian.T @ jacobian
    gradient = jacobian.T @ (values - fitted) - precision * variance * (state * linear)
    state = state + np.linalg.solve(normal + np.diag(precision * variance), gradient)
    low, high = _bounds(rhythms).T
    state[model.rates] = np.clip(state[model.rates], low, high)
    fitted = model.values(state, seconds)
    power = float(np.sum((values - fitted) ** 2))
    noise = max(power / max(len(values) - model.size, 1), _MIN_NOISE_M**2)
    return _Fit(
        model=model,
        state=state,
        covariance=np.asarray(np.linalg.inv(normal / noise + np.diag(precision))),
        values=fitted,
        power=power,
    )
