"""Motion predictors by name."""

from collections.abc import Callable, Mapping
from typing import Any

from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.errors import InvalidValueError
from laploop.registry import Registry

PREDICTORS: Registry[Callable[..., MotionPredictor]] = Registry(
    "prediction",
    "laploop.predictors",
    {
        "none": "laploop.control.prediction.alpha_beta:HeldMeasurement",
        "rate": "laploop.control.prediction.alpha_beta:AlphaBetaFilter.of",
        "rhythms": "laploop.control.prediction.rhythm_predictor:RhythmPredictor.of",
    },
)
"""How the age of the depth is bridged: `none` holds the newest measurement, `rate` goes on at the rate seen last, `rhythms`
learns breathing and heartbeat. An entry is called with the user's arguments by name."""


def make_predictor(name: str, arguments: Mapping[str, Any] | None = None) -> MotionPredictor:
    """Make a predictor.

    Args:
        name: A registered name, or `module:Class`.
        arguments: What its entry takes, by name.

    Raises:
        UnknownNameError: If nobody registered the name.
        InvalidValueError: If it cannot be imported, does not take the arguments, or is no predictor.
    """
    made = PREDICTORS.make(name, **(arguments or {}))
    if not isinstance(made, MotionPredictor):
        raise InvalidValueError("prediction", name, f"one with reset, update and predict; it made a {type(made).__name__}")
    return made
