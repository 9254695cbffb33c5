"""How the tissue at the target has moved, as measured and as predicted."""

from dataclasses import dataclass

import numpy as np

from laploop.arrays import Array
from laploop.control.prediction.alpha_beta import AlphaBetaFilter, AlphaBetaFilterConfig, HeldMeasurement
from laploop.control.prediction.motion_predictor import BackgroundWork, MotionPredictor, checked_prediction


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """Motion since the reference frame, along the axes of its camera."""

    displacement: Array
    """(3,), metres."""
    velocity: Array
    """(3,), m/s."""
    predicted: bool
    """Whether the part along the optical axis is a trusted prediction."""


class TissueMotion:
    """Filters what is measured of the tissue's motion and looks ahead across the age of the measurements.

    Along the optical axis the predictor is used while it is trusted, the rate measured last otherwise, and always across the
    axis. The predictor's work is spread over control ticks: it learns from a measurement one tick after it was made, and does
    its background work, if it has any, in ticks in which nothing was measured or learnt.
    """

    def __init__(self, tracker: AlphaBetaFilterConfig, predictor: MotionPredictor) -> None:
        """Take the gains of the filters and the predictor; with `HeldMeasurement` nothing is extrapolated."""
        self._predictor = predictor
        self._background = predictor if isinstance(predictor, BackgroundWork) else None
        held = isinstance(predictor, HeldMeasurement)
        self._axes = [HeldMeasurement() if held else AlphaBetaFilter(tracker) for _ in range(3)]
        self._unlearnt: tuple[float | None, int] | None = None

    def restart(self, captured_ns: int) -> None:
        """Forget everything; the displacement at this time is zero."""
        self._predictor.reset()
        for axis in self._axes:
            axis.reset()
            axis.update(0.0, captured_ns)
        self._unlearnt = 0.0, captured_ns

    @property
    def measured_ns(self) -> int:
        """Time of the last measurement along the optical axis that was accepted."""
        return self._axes[2].measured_ns

    def work(self, *, idle: bool) -> None:
        """Do at most one heavy thing: let the predictor learn, or do background work if the tick is idle otherwise."""
        if self._unlearnt is not None:
            self._predictor.update(*self._unlearnt)
            self._unlearnt = None
        elif idle and self._background is not None:
            self._background.work()

    def add(self, displacement: float | None, captured_ns: int) -> None:
        """Take in the displacement along the optical axis, None if it could not be measured."""
        self._axes[2].update(displacement, captured_ns)
        self._unlearnt = displacement, captured_ns

    def add_across(self, displacement: Array, captured_ns: int) -> None:
        """Take in the displacement across the optical axis, (2,)."""
        for axis, measured in zip(self._axes, displacement.tolist(), strict=False):
            axis.update(measured, captured_ns)

    def expected_at(self, time_ns: int) -> Array:
        """Return the displacement (3,) that a measurement should find, from earlier measurements alone."""
        return np.array([axis.displacement_at(time_ns) for axis in self._axes])

    def at(self, time_ns: int) -> Motion:
        """Return displacement and velocity at a time."""
        displacement = self.expected_at(time_ns)
        velocity = np.array([axis.rate_at(time_ns) for axis in self._axes])
        prediction = checked_prediction(self._predictor, time_ns)
        if prediction.trusted:
            displacement[2], velocity[2] = prediction.value, prediction.velocity
        return Motion(displacement=displacement, velocity=velocity, predicted=prediction.trusted)
