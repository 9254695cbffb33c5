"""What a motion predictor is: measurements that are late go in, where the tissue is now comes out."""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """What a predictor says of a time."""

    value: float
    """Displacement in metres."""
    velocity: float
    """m/s."""
    sigma: float = math.inf
    """Standard deviation of the value in metres as the predictor sees it; infinite where it has no idea."""
    trusted: bool
    """Whether to rely on value and velocity; otherwise `Targeting` extrapolates at the rate measured last."""


@runtime_checkable
class MotionPredictor(Protocol):
    """Predicts a displacement from late measurements of it."""

    def reset(self) -> None:
        """Forget everything."""
        ...

    def update(self, measured: float | None, captured_ns: int) -> bool:
        """Take in the displacement in metres at the time of capture, None if nothing was measured; return if accepted."""
        ...

    def predict(self, at_ns: int) -> Prediction:
        """Return where the tissue is, or will be, at a time."""
        ...


@runtime_checkable
class BackgroundWork(Protocol):
    """What a predictor may have besides: work to be done in control ticks that have nothing else to do."""

    def work(self) -> None:
        """Do a bounded piece of what is still to be done, if there is anything."""
        ...


def checked_prediction(predictor: MotionPredictor, at_ns: int) -> Prediction:
    """Ask a predictor and check its answer.

    Raises:
        InvalidValueError: If it is no `Prediction`, or one whose value or velocity is not a finite number.
    """
    answer: object = predictor.predict(at_ns)
    try:
        if isinstance(answer, Prediction) and math.isfinite(answer.value) and math.isfinite(answer.velocity):
            return answer
    except TypeError:
        pass
    name = f"answer of {type(predictor).__name__}.predict"
    raise InvalidValueError(name, answer, "a Prediction whose value (m) and velocity (m/s) are finite numbers")
