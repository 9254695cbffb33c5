"""Where a moving point will be, from measurements that are late: prediction by rhythms, with its trust."""

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from laploop.control.prediction.filter_consistency import FilterConsistency
from laploop.control.prediction.harmonic_filter import HarmonicFilter, HarmonicNoise
from laploop.control.prediction.rhythm_search import Hypothesis, RhythmSearch, RhythmSearchConfig
from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import check_range


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """What a predictor says of a time."""

    value: float
    """Metres; without trust the newest measurement that is believed."""
    velocity: float
    """m/s; without trust zero."""
    sigma: float
    """Standard deviation of the value in metres as the predictor sees it; infinite where it has no idea."""
    trusted: bool
    """Whether value and velocity are a prediction; else they are the newest measurement, held."""


class MotionPredictor(Protocol):
    """Anything that predicts a displacement from late measurements of it."""

    def reset(self) -> None:
        """Forget everything."""
        ...

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Take in what was measured at the time of capture, None if nothing was; say whether it is believed."""
        ...

    def predict(self, at_ns: int) -> Prediction:
        """Say where the point is, or will be, at a time."""
        ...


class BackgroundWork(Protocol):
    """What a predictor may have besides: work that is better done where a control tick has time for it."""

    def work(self) -> bool:
        """Do a bounded piece of what is still to be done; say whether there was anything."""
        ...


class HeldMeasurement:
    """The predictor that does not predict: the newest measurement, as it stands."""

    def __init__(self) -> None:
        """Start without a measurement."""
        self.reset()

    def reset(self) -> None:
        """Forget the measurement."""
        self._value = 0.0
        self._time_ns: int | None = None

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Keep a finite measurement that is newer than the last."""
        if measured is None or not math.isfinite(measured) or (self._time_ns is not None and captured_ns <= self._time_ns):
            return False
        self._value, self._time_ns = float(measured), captured_ns
        return True

    def predict(self, at_ns: int) -> Prediction:  # noqa: ARG002  the protocol's signature
        """Return the measurement, or 0 before the first."""
        return Prediction(value=self._value, velocity=0.0, sigma=math.inf, trusted=False)


@dataclass(frozen=True, kw_only=True)
class RhythmPredictorConfig:
    """Search, filter, and the rules of belief and trust."""

    search: RhythmSearchConfig = field(default_factory=RhythmSearchConfig)
    noise: HarmonicNoise = field(default_factory=HarmonicNoise)
    sample_spacing_s: float = 0.03
    """The search looks at samples at least that far apart, so that a fast camera does not make it slow."""
    gate: float = 5.0
    """Standard deviations of the innovation beyond which a measurement is not believed at once."""
    least_jump_m: float = 0.001
    """Smaller innovations are never turned away."""
    unsure_jump_m: float = 0.006
    """Without a trusted filter a measurement farther than this from what is expected is not believed at once."""
    agreement_m: float = 0.0015
    """Measurements whose innovations differ by no more than this tell of a step of the bias."""
    persistence: int = 4
    """So many in a row are believed to be a step."""
    patience: int = 15
    """After so many in a row without agreement all is forgotten."""
    forecast_s: float = 0.12
    """How far ahead the forecasts are made whose errors are watched: about the age of the frames."""
    window: int = 50
    """Measurements and forecasts in the statistics of trust."""
    least_forecasts: int = 12
    """So many of them must be there."""
    max_nis: float = 2.5
    """Bound of the mean normalised innovation squared, 1 for a filter that is right about itself."""
    max_forecast_ratio: float = 1.0
    """Bound of the forecasts' mean squared error relative to that of holding the newest measurement."""
    forecast_floor_m: float = 0.00005
    """Root mean square error of forecasts that is good enough in any case, as on tissue at rest."""
    max_sigma_m: float = 0.001
    """Bound of the prediction's standard deviation."""
    max_silence_s: float = 0.5
    """A prediction farther than this from the last believed measurement is not trusted."""
    trial: int = 25
    """So many forecasts are compared before the result of a new search may replace the running filter."""
    improvement: float = 0.85
    """It does if its forecasts' mean squared error is less than this share of the running filter's."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("sample_spacing_s", self.sample_spacing_s, 0.005, 0.2)
        check_range("gate", self.gate, 2.0, 100.0)
        for name in ("least_jump_m", "unsure_jump_m", "agreement_m", "max_sigma_m"):
            check_range(name, getattr(self, name), 1e-5, 0.1)
        check_range("persistence", self.persistence, 2, 100)
        check_range("patience", self.patience, self.persistence, 1000)
        check_range("forecast_s", self.forecast_s, 0.01, 1.0)
        check_range("window", self.window, 2, 1000)
        check_range("least_forecasts", self.least_forecasts, 1, self.window)
        check_range("max_nis", self.max_nis, 1.0, 100.0)
        check_range("max_forecast_ratio", self.max_forecast_ratio, 0.1, 10.0)
        check_range("forecast_floor_m", self.forecast_floor_m, 0.0, 0.1)
        check_range("max_silence_s", self.max_silence_s, 0.01, 10.0)
        check_range("trial", self.trial, 1, self.window)
        check_range("improvement", self.improvement, 0.0, 1.0)


class RhythmPredictor:
    """Predicts a displacement that is a bias plus respiration plus heartbeat of unknown, drifting frequencies.

    A search over the last seconds goes on all the time, one slice a measurement. What it finds starts a Kalman filter on bias,
    frequencies and phasors, which follows drift. Later findings start a second filter on trial, which replaces the first if it
    forecasts clearly better. Search and trial are done by `work` between measurements, piece by piece, or else with the next
    one, which comes to the same. A measurement that surprises a trusted filter is put aside; several alike in a row
    are a step of the bias (tissue pushed, stage moved), several that do not agree end the filter. An overtaken or invalid
    measurement is ignored.
    """

    def __init__(self, config: RhythmPredictorConfig | None = None) -> None:
        """Start with nothing known."""
        self._config = config = config or RhythmPredictorConfig()
        self._window = SampleWindow(span_s=config.search.span_s, spacing_s=config.sample_spacing_s)
        self._search = RhythmSearch(config.search, self._window)
        self._running: FilterConsistency | None
        self._trial: FilterConsistency | None
        self._newest_ns: int | None
        self._doubtful: list[float]
        self._consistent: bool
        self._work_due: bool
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._newest_ns = None
        self._accepted_ns = 0
        self._nominal = 0.0
        self._forget()

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequencies of the rhythms that are followed; empty before any is known, and without any."""
        return () if self._running is None else tuple(float(hertz) for hertz in self._running.filter.frequencies_hz)

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Take in a displacement in metres, None or not finite if invalid; say whether it is believed."""
        if measured is None or not math.isfinite(measured):
            return False
        if self._newest_ns is not None and captured_ns <= self._newest_ns:
            return False
        first = self._newest_ns is None
        while self._work_due:
            self.work()
        self._compare()
        self._newest_ns = captured_ns
        value = float(measured)
        if self._running is not None:
            self._running.advance(captured_ns)
            innovation, variance = self._running.filter.innovation(value)
        else:
            innovation, variance = (0.0 if first else value - self._nominal), 0.0
        if self._consistent:
            bound = max(self._config.gate * math.sqrt(variance), self._config.least_jump_m)
        else:
            bound = self._config.unsure_jump_m
        believed = abs(innovation) <= bound or self._persists(innovation)
        if believed:
            self._believe(value, captured_ns)
        return believed

    def predict(self, at_ns: int) -> Prediction:
        """Say where the point is, or will be, at a time; any horizon, but trust ends with `max_silence_s`."""
        if self._running is None:
            return Prediction(value=self._nominal, velocity=0.0, sigma=math.inf, trusted=False)
        outlook, sigma = self._running.filter.outlook(at_ns)
        fresh = (at_ns - self._accepted_ns) * 1e-9 <= self._config.max_silence_s
        if not (self._consistent and fresh and sigma <= self._config.max_sigma_m):
            return Prediction(value=self._nominal, velocity=0.0, sigma=sigma, trusted=False)
        return Prediction(value=outlook.value, velocity=outlook.velocity, sigma=sigma, trusted=True)

    def _believe(self, value: float, time_ns: int) -> None:
        self._doubtful.clear()
        self._nominal, self._accepted_ns = value, time_ns
        self._window.add(time_ns, value)
        if self._running is not None:
            self._running.correct(value)
        self._work_due = True
        self._consistent = self._running is not None and self._is_consistent(self._running)

    def _is_consistent(self, record: FilterConsistency) -> bool:
        config = self._config
        bound = max(config.max_forecast_ratio * record.held_variance, config.forecast_floor_m**2)
        return (
            record.forecasts >= config.least_forecasts
            and record.mean_nis <= config.max_nis
            and record.forecast_variance <= bound
        )

    def _persists(self, innovation: float) -> bool:
        """Remember a innovation; say whether several in a row have been alike, and move the bias by them if so."""
        config = self._config
        self._doubtful.append(innovation)
        recent = self._doubtful[-config.persistence :]
        if len(recent) == config.persistence and max(recent) - min(recent) <= config.agreement_m:
            step = float(np.median(recent))
            self._window.shift(step)
            self._search.reset()
            self._work_due = False
            self._trial = None
            self._consistent = False
            if self._running is not None:
                self._running.shift(step, config.agreement_m)
            return True
        if len(self._doubtful) >= config.patience:
            self._forget()
            return True
        return False

    def work(self) -> bool:
        """Tell the filter on trial the last measurement, or else do a piece of the search; say whether that was due."""
        if not self._work_due:
            return False
        if self._trial is not None:
            self._trial.advance(self._accepted_ns)
            self._trial.correct(self._nominal)
            self._work_due = False
            return True
        found = self._search.step()
        self._work_due = self._search.midway
        if found is not None:
            self._start(found)
        return True

    def _start(self, found: Hypothesis) -> None:
        """Let a filter run on what was found, or try it beside the one that runs."""
        started = HarmonicFilter(
            found.model,
            self._config.noise,
            time_ns=found.time_ns,
            state=found.state,
            covariance=found.covariance,
            bounds_rad_s=found.bounds_rad_s,
            measurement_sigma_m=found.residual_m,
        )
        started.advance(self._accepted_ns)
        record = FilterConsistency(started, horizon_ns=round(self._config.forecast_s * 1e9), window=self._config.window)
        if self._running is None:
            self._running = record
        else:
            self._trial = record

    def _compare(self) -> None:
        """End a trial that has lasted long enough."""
        running, trial = self._running, self._trial
        if running is None or trial is None or trial.forecasts < self._config.trial:
            return
        if trial.forecast_variance < self._config.improvement * running.recent_forecast_variance(trial.forecasts):
            self._running = trial
            self._consistent = self._is_consistent(trial)
        self._trial = None

    def _forget(self) -> None:
        """Drop filters and window; the newest measurement stays."""
        self._running = None
        self._trial = None
        self._consistent = False
        self._doubtful = []
        self._window.clear()
        self._search.reset()
        self._work_due = False
