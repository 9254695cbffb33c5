"""Find the frequencies of up to two rhythms, and all their phasors, in the last seconds of a signal."""

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from laploop.control.prediction.harmonic_model import HarmonicModel, harmonic_model
from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import InvalidValueError, check_range

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RhythmBand:
    """Where a rhythm is looked for."""

    lowest_hz: float
    highest_hz: float
    harmonics: int
    step_hz: float
    """Spacing of the frequencies that are tried before the best is refined."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("lowest_hz", self.lowest_hz, 0.02, 10.0)
        check_range("highest_hz", self.highest_hz, self.lowest_hz, 10.0)
        check_range("harmonics", self.harmonics, 1, 6)
        check_range("step_hz", self.step_hz, 0.002, 1.0)

    def candidates(self) -> Array:
        """Return the frequencies to try, in Hz."""
        count = math.ceil((self.highest_hz - self.lowest_hz) / self.step_hz) + 1
        return np.linspace(self.lowest_hz, self.highest_hz, count)

    def bounds_rad_s(self) -> tuple[float, float]:
        """Return how far a rhythm may drift, as angular frequencies: a tenth beyond the band."""
        return 2.0 * math.pi * 0.9 * self.lowest_hz, 2.0 * math.pi * 1.1 * self.highest_hz


@dataclass(frozen=True, kw_only=True)
class RhythmSearchConfig:
    """What is looked for, and how much signal that takes."""

    bands: tuple[RhythmBand, ...] = field(
        default_factory=lambda: (
            RhythmBand(lowest_hz=0.1, highest_hz=0.6, harmonics=3, step_hz=0.02),
            RhythmBand(lowest_hz=0.7, highest_hz=2.5, harmonics=2, step_hz=0.04),
        )
    )
    """Respiration and heartbeat, slow before fast."""
    span_s: float = 10.0
    """Signal that is looked at, at most."""
    least_span_s: float = 3.0
    """No search before that."""
    least_periods: float = 0.9
    """Of a rhythm's period, so many must have been seen."""
    significance: float = 10.0
    """Least ratio of the power a rhythm explains to the power left, each per degree of freedom."""
    least_amplitude_m: float = 0.00005
    """A weaker rhythm is left out."""
    chunk: int = 5
    """Frequencies tried in one slice of work."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("least_span_s", self.least_span_s, 0.5, self.span_s)
        check_range("least_periods", self.least_periods, 0.5, 10.0)
        check_range("significance", self.significance, 1.0, 1000.0)
        check_range("least_amplitude_m", self.least_amplitude_m, 0.0, 0.01)
        check_range("chunk", self.chunk, 1, 1000)
        if any(slow.highest_hz >= fast.lowest_hz for slow, fast in zip(self.bands, self.bands[1:], strict=False)):
            raise InvalidValueError("bands", self.bands, "bands in rising order that do not overlap")


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
    """A search that is done in slices, and those in pieces, so that no call takes long; it starts over when it is done.

    Band by band, least squares at each frequency of a grid tell how much of what is left its harmonics explain. The best
    one is refined together with the rhythms already found by Gauss-Newton steps on all phasors and frequencies. A rhythm's
    fundamental must be its strongest harmonic, which keeps subharmonics and strangers out.
    """

    def __init__(self, config: RhythmSearchConfig, window: SampleWindow) -> None:
        """Take the window, which others fill."""
        self._config = config
        self._window = window
        self.reset()

    def reset(self) -> None:
        """Give up what was begun."""
        self._work: Iterator[bool] = iter(())
        self._midway = False
        self._found: Hypothesis | None = None

    @property
    def midway(self) -> bool:
        """Whether the last piece did not end its slice; the window must stay as it is until one does."""
        return self._midway

    def step(self) -> Hypothesis | None:
        """Do one piece of a slice of work; return what was found if that was the last one."""
        if self._window.covered_s < self._config.least_span_s:
            return None
        self._found = None
        try:
            self._midway = next(self._work)
        except StopIteration:
            self._work = self._search(*self._window.snapshot())
            self._midway = next(self._work)
        return self._found

    def _search(self, time_ns: int, seconds: Array, values: Array) -> Generator[bool, None, None]:
        """Search, and leave what is found; yield after each piece whether its slice goes on."""
        found: tuple[tuple[RhythmBand, float], ...] = ()
        fit = _all_of(_refined((), seconds, values))
        yield True
        for band in self._config.bands:
            left = values - fit.values
            best_hz, best_power = 0.0, math.inf
            candidates = band.candidates()
            candidates = candidates[candidates * -seconds[0] >= self._config.least_periods]
            for start in range(0, len(candidates), self._config.chunk):
                some = candidates[start : start + self._config.chunk]
                basis = _harmonic_basis(some, band.harmonics, seconds)
                yield True
                powers = _power_left(basis, left)
                index = int(np.argmin(powers))
                if powers[index] < best_power:
                    best_hz, best_power = float(some[index]), float(powers[index])
                yield False
            if not math.isfinite(best_power):
                continue
            tried = (*found, (band, 2.0 * math.pi * best_hz))
            trial = fit
            for _ in range(3):
                trial = yield from _refined(tried, seconds, values)
                tried = tuple((one, rate) for (one, _), rate in zip(tried, trial.rates, strict=True))
                yield False
            if self._convincing(fit, trial, len(values)):
                found, fit = tried, trial
        self._found = Hypothesis(
            model=fit.model,
            time_ns=time_ns,
            state=fit.state,
            covariance=fit.covariance,
            bounds_rad_s=np.array([band.bounds_rad_s() for band, _ in found]).reshape(-1, 2),
            residual_m=math.sqrt(fit.power / len(values)),
        )
        yield False

    def _convincing(self, without: "_Fit", fit: "_Fit", count: int) -> bool:
        """Say whether the last rhythm of a fit is worth its parameters, strong enough, and led by its fundamental."""
        more = fit.model.size - without.model.size
        spare = max(count - fit.model.size, 1)
        explained = (without.power - fit.power) / more
        strengths = np.abs(fit.model.phasors(fit.state))[fit.model.rhythm == len(fit.model.harmonics) - 1]
        return bool(
            explained > self._config.significance * fit.power / spare
            and strengths[0] >= self._config.least_amplitude_m
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
_LEAST_NOISE_M = 2e-5


def _all_of(pieces: Generator[bool, None, _Fit]) -> _Fit:
    """Do all pieces at once, where there are so few numbers that they are no work."""
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            fit: _Fit = end.value
            return fit


def _harmonic_basis(candidates_hz: Array, harmonics: int, seconds: Array) -> Array:
    """Return a bias and the harmonics of each frequency at all times, (candidates, 1 + 2 harmonics, m)."""
    turn = np.exp(2j * np.pi * candidates_hz[:, None] * seconds)
    basis = np.ones((len(candidates_hz), 1 + 2 * harmonics, len(seconds)))
    power = turn
    for order in range(harmonics):
        basis[:, 1 + 2 * order] = power.real
        basis[:, 2 + 2 * order] = power.imag
        power = power * turn
    return basis


def _power_left(basis: Array, values: Array) -> Array:
    """Return the sum of squares left after least squares of each frequency's basis, (candidates,).

    It is infinite where the fundamental is not the strongest harmonic: there the true frequency is a multiple.
    """
    gram = basis @ basis.swapaxes(1, 2)
    projected = basis @ values
    # A little of the diagonal keeps short windows solvable.
    gram.reshape(len(gram), -1)[:, :: gram.shape[-1] + 1] *= 1.0 + 1e-6
    solved = np.linalg.solve(gram, projected[..., None])[..., 0]
    strengths = np.hypot(solved[:, 1::2], solved[:, 2::2])
    left = values @ values - np.add.reduce(projected * solved, axis=1)
    return np.where(strengths[:, 0] >= strengths.max(axis=1), left, np.inf)


def _refined(rhythms: tuple[tuple[RhythmBand, float], ...], seconds: Array, values: Array) -> Generator[bool, None, _Fit]:
    """Fit bias and phasors at given angular frequencies, then make one Gauss-Newton step on everything.

    This is done in three pieces; it yields True, for a slice that goes on, between them.
    """
    model = harmonic_model(tuple(band.harmonics for band, _ in rhythms))
    state, precision = np.zeros(model.size), np.full(model.size, _PRIOR_AMPLITUDE_M**-2)
    state[model.rates] = [rate for _, rate in rhythms]
    precision[0] = _PRIOR_BIAS_M**-2
    precision[model.rates] = (_PRIOR_FREQUENCY * state[model.rates]) ** -2.0
    variance = 1e-6
    linear = np.ones(model.size, dtype=bool)
    linear[model.rates] = False
    turns = model.turns(state, seconds)
    jacobian = model.linear_table(turns)
    yield True
    basis = jacobian[:, linear]
    normal = basis.T @ basis + np.diag(precision[linear] * variance)
    state[linear] = np.linalg.solve(normal, basis.T @ values)
    fitted = model.fill_table(jacobian, state, seconds, turns)
    normal = jacobian.T @ jacobian
    step = np.linalg.solve(
        normal + np.diag(precision * variance), jacobian.T @ (values - fitted) - precision * variance * (state * linear)
    )
    yield True
    low, high = (np.array([band.bounds_rad_s()[side] for band, _ in rhythms]) for side in (0, 1))
    state = state + step
    state[model.rates] = np.minimum(np.maximum(state[model.rates], low), high)
    fitted = model.values(state, seconds)
    left = values - fitted
    power = float(left @ left)
    noise = max(power / max(len(values) - model.size, 1), _LEAST_NOISE_M**2)
    return _Fit(
        model=model,
        state=state,
        covariance=np.asarray(np.linalg.inv(normal / noise + np.diag(precision)), dtype=np.float64),
        values=fitted,
        power=power,
    )
