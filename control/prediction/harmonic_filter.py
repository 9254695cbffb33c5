"""An extended Kalman filter of a bias and the harmonics of rhythms whose frequencies drift."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.control.prediction.harmonic_model import HarmonicModel, Outlook
from laploop.errors import check_range

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class HarmonicNoise:
    """How restless the state is: standard deviations after one second of each random walk, and of the measurement."""

    bias_m: float = 0.00005
    frequency: float = 0.01
    """Relative to the frequency."""
    phase_rad: float = 0.02
    """Of a rhythm's clock; it moves all its harmonics together."""
    amplitude: float = 0.01
    """Of every phasor, relative to the amplitude of its rhythm, and less for higher orders (1/k)."""
    measurement_floor_m: float = 0.00004
    """The measurement's noise is learnt between these bounds."""
    measurement_ceiling_m: float = 0.0006
    measurement_memory: int = 100
    """Number of measurements over which its variance is averaged."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("bias_m", self.bias_m, 0.0, 0.01)
        for name in ("frequency", "phase_rad", "amplitude"):
            check_range(name, getattr(self, name), 0.0, 1.0)
        check_range("measurement_floor_m", self.measurement_floor_m, 1e-6, 0.005)
        check_range("measurement_ceiling_m", self.measurement_ceiling_m, self.measurement_floor_m, 0.01)
        check_range("measurement_memory", self.measurement_memory, 2, 100_000)


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
            noise: Restlessness.
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
        self._bounds = [
            (place, low, high) for place, (low, high) in zip(model.rates.tolist(), bounds_rad_s.tolist(), strict=True)
        ]
        self._variance_range = (noise.measurement_floor_m**2, noise.measurement_ceiling_m**2)
        self._measured_variance = float(np.clip(measurement_sigma_m**2, *self._variance_range))
        self._observation = model.look_ahead(state, 0.0).gradient
        # Variances a second by the squares of the state: those of the phasors by the power of their rhythm, and of the rates.
        share = (noise.amplitude / model.order[:, None]) ** 2 * (model.rhythm[:, None] == model.rhythm)
        self._restless = np.zeros((model.size, model.size))
        for rows in (model.real, model.imaginary):
            for columns in (model.real, model.imaginary):
                self._restless[np.ix_(rows, columns)] = share
        self._restless[model.rates, model.rates] = noise.frequency**2
        # What the random walks add to an outlook, by the summed squares of all amplitudes.
        self._wander = noise.phase_rad**2 + noise.amplitude**2

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
        gradient = outlook.gradient
        variance = float(gradient @ (self._covariance @ gradient))
        # What the random walks add on the way, as if all phasors were seen in full.
        wander = self._noise.bias_m**2 + self._wander * outlook.power
        return outlook, math.sqrt(max(variance, 0.0) + abs(seconds) * wander)

    def value_at(self, time_ns: int) -> float:
        """Return the value to expect at a time."""
        return self.model.value_ahead(self._state, (time_ns - self.time_ns) * 1e-9)

    def advance(self, time_ns: int, *, process_noise_scale: float = 1.0) -> None:
        """Carry the state on to a later time; `process_noise_scale` multiplies the variances of all random walks."""
        seconds = (time_ns - self.time_ns) * 1e-9
        model, noise = self.model, self._noise
        self._state, transition = model.advance(self._state, seconds)
        covariance = transition @ self._covariance @ transition.T
        diagonal = self._restless @ (self._state * self._state)
        diagonal[0] = noise.bias_m**2
        directions = model.phase_directions(self._state)
        covariance += (process_noise_scale * seconds * noise.phase_rad**2) * (directions.T @ directions)
        covariance.reshape(-1)[:: model.size + 1] += process_noise_scale * seconds * diagonal
        self._covariance = 0.5 * (covariance + covariance.T)
        self.time_ns = time_ns

    def innovation(self, measured: float) -> tuple[float, float]:
        """Return what a measurement made now differs from the expected, and the variance of that, noise included."""
        expected = float(self._observation @ self._state)
        spread = float(self._observation @ (self._covariance @ self._observation))
        return measured - expected, spread + self._measured_variance

    def correct(self, measured: float) -> float:
        """Take in a measurement made at the state's time; return its normalised innovation squared."""
        innovation, variance = self.innovation(measured)
        gain = self._covariance @ self._observation / variance
        self._state += gain * innovation
        self._covariance -= np.multiply.outer(variance * gain, gain)
        for place, low, high in self._bounds:
            rate = self._state[place]
            if not low <= rate <= high:
                self._state[place] = min(max(rate, low), high)
        self._learn_noise(innovation, variance)
        return innovation**2 / variance

    def shift(self, step: float, sigma: float) -> None:
        """Move the bias by a step that is known to a standard deviation."""
        self._state[0] += step
        self._covariance[0, 0] += sigma**2

    def _learn_noise(self, innovation: float, variance: float) -> None:
        """Average the part of the squared innovation that the state's own uncertainty does not explain."""
        share = 1.0 / self._noise.measurement_memory
        unexplained = innovation**2 - (variance - self._measured_variance)
        low, high = self._variance_range
        learnt = (1.0 - share) * self._measured_variance + share * min(max(unexplained, 0.0), 9.0 * self._measured_variance)
        self._measured_variance = min(max(learnt, low), high)
