"""Prediction by the rhythms of respiration and heartbeat, of unknown and drifting frequency."""

import math
from typing import Annotated, Any

import numpy as np

from laploop.configuration import Field, configuration, from_plain
from laploop.control.prediction.filter_consistency import FilterConsistency
from laploop.control.prediction.harmonic_filter import HarmonicFilter, HarmonicNoise
from laploop.control.prediction.motion_predictor import Prediction
from laploop.control.prediction.rhythm_search import Hypothesis, RhythmSearch, RhythmSearchConfig
from laploop.control.prediction.sample_window import SampleWindow
from laploop.errors import InvalidValueError

Jump = Annotated[float, Field(ge=1e-5, le=0.1)]


@configuration
class RhythmPredictorConfig:
    """Search, filter, and the rules by which measurements are accepted and predictions are trusted."""

    search: RhythmSearchConfig = Field(default_factory=RhythmSearchConfig)
    """How rhythms are found."""
    noise: HarmonicNoise = Field(default_factory=HarmonicNoise)
    """What the filter assumes."""
    sample_spacing_s: Annotated[float, Field(ge=0.005, le=0.2)] = 0.03
    """Least spacing of the samples that the search looks at, so that a fast camera does not make it slow."""
    gate: Annotated[float, Field(ge=2.0, le=100.0)] = 5.0
    """Standard deviations of the innovation beyond which a measurement is not accepted at once."""
    min_jump_m: Jump = 0.001
    """Innovations below this are always accepted."""
    max_jump_m: Jump = 0.006
    """Largest innovation that is accepted at once without a trusted filter."""
    agreement_m: Jump = 0.0015
    """Spread of consecutive rejected innovations up to which they count as a step of the bias."""
    persistence: Annotated[int, Field(ge=2, le=100)] = 4
    """Number of consecutive rejected measurements that make a step of the bias."""
    patience: Annotated[int, Field(ge=2, le=1000)] = 15
    """Number of consecutive rejected measurements without agreement after which everything is forgotten."""
    forecast_s: Annotated[float, Field(ge=0.01, le=1.0)] = 0.12
    """How far ahead the forecasts are made whose errors are watched: about the age of the frames."""
    window: Annotated[int, Field(ge=2, le=1000)] = 50
    """Number of measurements and forecasts in the statistics of trust."""
    min_forecasts: Annotated[int, Field(ge=1, le=1000)] = 12
    """Number of forecasts before which nothing is trusted."""
    max_nis: Annotated[float, Field(ge=1.0, le=100.0)] = 2.5
    """Bound of the mean normalised innovation squared, 1 for a filter that is right about itself."""
    max_forecast_ratio: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Bound of the forecasts' mean squared error relative to that of holding the newest measurement."""
    forecast_floor_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.00005
    """Root mean square error of forecasts that is good enough in any case, as on tissue at rest."""
    max_sigma_m: Jump = 0.001
    """Bound of the prediction's standard deviation."""
    max_silence_s: Annotated[float, Field(ge=0.01, le=10.0)] = 0.5
    """Time since the last accepted measurement after which a prediction is not trusted."""
    trial: Annotated[int, Field(ge=1, le=1000)] = 25
    """Number of forecasts compared before the result of a new search may replace the running filter."""
    improvement: Annotated[float, Field(ge=0.0, le=1.0)] = 0.85
    """It does if its forecasts' mean squared error is below this fraction of the running filter's."""

    def __post_init__(self) -> None:
        if self.patience < self.persistence:
            raise InvalidValueError("patience", self.patience, f"at least persistence ({self.persistence})")
        for name in ("min_forecasts", "trial"):
            if getattr(self, name) > self.window:
                raise InvalidValueError(name, getattr(self, name), f"at most window ({self.window})")


class RhythmPredictor:
    """A `MotionPredictor` for a bias plus respiration plus heartbeat of unknown, drifting frequencies.

    A search over the last seconds goes on all the time. What it finds starts a Kalman filter on bias, frequencies and
    phasors, which follows drift. Later findings start a second filter on trial, which replaces the first if it forecasts
    clearly better. Each accepted measurement makes one piece of work due, of the search or the trial: `work` does it, or else
    the next measurement, which comes to the same. A trusted filter rejects measurements with a large innovation; several
    alike in a row are a step of the bias (tissue pushed, stage moved), several that do not agree end the filter. An overtaken
    or invalid measurement is ignored.
    """

    def __init__(self, config: RhythmPredictorConfig | None = None) -> None:
        self._config = config = config or RhythmPredictorConfig()
        self._window = SampleWindow(span_s=config.search.span_s, spacing_s=config.sample_spacing_s)
        self._search = RhythmSearch(config.search, self._window)
        self._running: FilterConsistency | None
        self._trial: FilterConsistency | None
        self._newest_ns: int | None
        self._rejected: list[float]
        self._consistent: bool
        self._work_due: bool
        self.reset()

    @classmethod
    def of(cls, **fields: Any) -> "RhythmPredictor":
        """Make a predictor from the fields of its configuration, nested ones as mappings."""
        return cls(from_plain(RhythmPredictorConfig, fields))

    def reset(self) -> None:
        """Forget everything."""
        self._newest_ns = None
        self._accepted_ns = 0
        self._accepted = 0.0
        self._forget()

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Frequencies of the rhythms that are followed; empty before any is known, and without any."""
        return () if self._running is None else tuple(self._running.filter.frequencies_hz.tolist())

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Take in a displacement in metres, None or not finite if invalid; return whether it is accepted."""
        if measured is None or not math.isfinite(measured):
            return False
        if self._newest_ns is not None and captured_ns <= self._newest_ns:
            return False
        self.work()
        self._end_trial()
        value = float(measured)
        if self._running is not None:
            self._running.advance(captured_ns)
            innovation, variance = self._running.filter.innovation(value)
        else:
            innovation, variance = (0.0 if self._newest_ns is None else value - self._accepted), 0.0
        self._newest_ns = captured_ns
        if self._consistent:
            bound = max(self._config.gate * math.sqrt(variance), self._config.min_jump_m)
        else:
            bound = self._config.max_jump_m
        accepted = abs(innovation) <= bound or self._persists(innovation)
        if accepted:
            self._accept(value, captured_ns)
        return accepted

    def predict(self, at_ns: int) -> Prediction:
        """Return where the tissue is at a time; without trust, the newest accepted measurement, held."""
        if self._running is None:
            return Prediction(value=self._accepted, velocity=0.0, trusted=False)
        outlook, sigma = self._running.filter.outlook(at_ns)
        fresh = (at_ns - self._accepted_ns) * 1e-9 <= self._config.max_silence_s
        if not (self._consistent and fresh and sigma <= self._config.max_sigma_m):
            return Prediction(value=self._accepted, velocity=0.0, sigma=sigma, trusted=False)
        return Prediction(value=outlook.value, velocity=outlook.velocity, sigma=sigma, trusted=True)

    def work(self) -> None:
        """Tell the filter on trial the last measurement, or else do a slice of the search, if that is still due."""
        if not self._work_due:
            return
        self._work_due = False
        if self._trial is not None:
            self._trial.advance(self._accepted_ns)
            self._trial.correct(self._accepted)
        elif (found := self._search.step()) is not None:
            self._start(found)

    def _accept(self, value: float, time_ns: int) -> None:
        self._rejected.clear()
        self._accepted, self._accepted_ns = value, time_ns
        self._window.add(time_ns, value)
        if self._running is not None:
            self._running.correct(value)
        self._work_due = True
        self._consistent = self._running is not None and self._is_consistent(self._running)

    def _is_consistent(self, record: FilterConsistency) -> bool:
        config = self._config
        bound = max(config.max_forecast_ratio * record.held_variance, config.forecast_floor_m**2)
        return (
            record.forecasts >= config.min_forecasts and record.mean_nis <= config.max_nis and record.forecast_variance <= bound
        )

    def _persists(self, innovation: float) -> bool:
        """Remember a rejected innovation; if several in a row are alike, move the bias by them and return True."""
        config = self._config
        self._rejected.append(innovation)
        recent = self._rejected[-config.persistence :]
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
        if len(self._rejected) >= config.patience:
            self._forget()
            return True
        return False

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

    def _end_trial(self) -> None:
        """End a trial that has lasted long enough; the better filter goes on."""
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
        self._rejected = []
        self._window.clear()
        self._search.reset()
        self._work_due = False
