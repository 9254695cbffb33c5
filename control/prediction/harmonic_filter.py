"""An extended Kalman filter of a bias and the harmonics of rhythms whose frequencies drift."""

import math
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.prediction.harmonic_model import HarmonicModel, Outlook
from laploop.errors import InvalidValueError


@configuration
class HarmonicNoise:
    """Noise of the process and of the measurement: standard deviations after one second of each random walk."""

    bias_m: Annotated[float, Field(ge=0.0, le=0.01)] = 0.00005
    """Random walk of the bias."""
    frequency: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01
    """Random walk of a frequency, relative to it."""
    phase_rad: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """Random walk of a rhythm's clock; it moves all its harmonics together."""
    amplitude: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01
    """Random walk of every phasor, relative to the amplitude of its rhythm, and less for higher orders (1/k)."""
    measurement_floor_m: Annotated[float, Field(ge=1e-6, le=0.005)] = 0.00004
    """Least standard deviation of the measurement; it is learnt between the bounds."""
    measurement_ceiling_m: Annotated[float, Field(ge=1e-6, le=0.01)] = 0.0006
    """Greatest standard deviation of the measurement."""
    measurement_memory: Annotated[int, Field(ge=2, le=100_000)] = 100
    """Number of measurements over which its variance is averaged."""

    def __post_init__(self) -> None:
        if self.measurement_ceiling_m < self.measurement_floor_m:
            allowed = f"at least measurement_floor_m ({self.measurement_floor_m})"
            raise InvalidValueError("measurement_ceiling_m", self.measurement_ceiling_m, allowed)


class HarmonicFilter:
    """Follows one `HarmonicModel` from a first state with its covariance; times are integer nanoseconds.

    Measurements must come in the order of their times. Frequencies stay within the bounds given.
    """

    def __init__(
        self,
        model: HarmonicModel,
        noise: HarmonicNoise,
        *,
        time_ns: int,
        state: Array,
        covariance: Array,
        bounds_rad_s: Array,
        measurement_sigma_m: float,
    ) -> None:
        """Start at a time.

        Args:
            model: Layout of the state.
            noise: Of process and measurement.
            time_ns: Time of the state.
            state: (size,).
            covariance: (size, size).
            bounds_rad_s: (rhythms, 2), lowest and highest angular frequency.
            measurement_sigma_m: First guess of the measurement's standard deviation.
        """
        self.model = model
        self._noise = noise
        self.time_ns = time_ns
        self._state = state.copy()
        self._covariance = covariance.copy()
        self._bounds = bounds_rad_s
        self._variance_range = (noise.measurement_floor_m**2, noise.measurement_ceiling_m**2)
        self._measured_variance = float(np.clip(measurement_sigma_m**2, *self._variance_range))
        # What is measured now does not depend on the rates.
        self._observation = model.look_ahead(state, 0.0).gradient

    @property
    def state(self) -> Array:
        """A copy of the state, (size,)."""
        return self._state.copy()

    @property
    def frequencies_hz(self) -> Array:
        """Frequency of each rhythm, (rhythms,)."""
        return np.asarray(self._state[self.model.rates] / (2.0 * math.pi))

    @property
    def measurement_sigma_m(self) -> float:
        """Standard deviation of the measurement as learnt so far."""
        return math.sqrt(self._measured_variance)

    def outlook(self, time_ns: int) -> tuple[Outlook, float]:
        """Return what to expect at a time, and the standard deviation of that value without measurement noise."""
        seconds = (time_ns - self.time_ns) * 1e-9
        outlook = self.model.look_ahead(self._state, seconds)
        variance = float(outlook.gradient @ self._covariance @ outlook.gradient)
        # What the random walks add on the way, as if all phasors were seen in full.
        noise, power = self._noise, float(self.model.powers(self._state).sum())
        walk = noise.bias_m**2 + (noise.phase_rad**2 + noise.amplitude**2) * power
        return outlook, math.sqrt(max(variance, 0.0) + abs(seconds) * walk)

    def value_at(self, time_ns: int) -> float:
        """Return the value to expect at a time."""
        return self.model.look_ahead(self._state, (time_ns - self.time_ns) * 1e-9).value

    def advance(self, time_ns: int, *, process_noise_scale: float = 1.0) -> None:
        """Carry the state on to a later time; `process_noise_scale` multiplies the variances of all random walks."""
        seconds = (time_ns - self.time_ns) * 1e-9
        self._state, transition = self.model.advance(self._state, seconds)
        covariance = transition @ self._covariance @ transition.T + process_noise_scale * seconds * self._process_noise()
        self._covariance = 0.5 * (covariance + covariance.T)
        self.time_ns = time_ns

    def innovation(self, measured: float) -> tuple[float, float]:
        """Return the innovation of a measurement made now, and its variance, the measurement's noise included."""
        expected = float(self._observation @ self._state)
        spread = float(self._observation @ self._covariance @ self._observation)
        return measured - expected, spread + self._measured_variance

    def correct(self, measured: float) -> float:
        """Take in a measurement made at the state's time; return its normalised innovation squared."""
        innovation, variance = self.innovation(measured)
        gain = self._covariance @ self._observation / variance
        self._state += gain * innovation
        self._covariance -= variance * np.outer(gain, gain)
        self._state[self.model.rates] = np.clip(self._state[self.model.rates], self._bounds[:, 0], self._bounds[:, 1])
        self._learn_noise(innovation, variance)
        return innovation**2 / variance

    def shift(self, step: float, sigma: float) -> None:
        """Move the bias by a step that is known to a standard deviation."""
        self._state[0] += step
        self._covariance[0, 0] += sigma**2

    def _process_noise(self) -> Array:
        """Return the variances that the random walks add in a second, (size, size)."""
        model, noise, state = self.model, self._noise, self._state
        phases = noise.phase_rad * model.phase_directions(state)
        variances = np.zeros(model.size)
        variances[0] = noise.bias_m**2
        variances[model.rates] = (noise.frequency * state[model.rates]) ** 2
        amplitudes = (noise.amplitude / model.order) ** 2 * model.powers(state)[model.rhythm]
        variances[model.real] = variances[model.imaginary] = amplitudes
        return np.asarray(phases.T @ phases + np.diag(variances))

    def _learn_noise(self, innovation: float, variance: float) -> None:
        """Average the part of the squared innovation that the state's own uncertainty does not explain."""
        weight = 1.0 / self._noise.measurement_memory
        unexplained = innovation**2 - (variance - self._measured_variance)
        low, high = self._variance_range
        learnt = (1.0 - weight) * self._measured_variance + weight * min(max(unexplained, 0.0), 9.0 * self._measured_variance)
        self._measured_variance = min(max(learnt, low), high)
