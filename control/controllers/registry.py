"""Controllers by name; the scripted ones have the name of their task, `image-servo` is a plain one for `look`."""

from collections.abc import Callable, Mapping
from typing import Any

from laploop.control.messages import TipController
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.prediction.registry import make_predictor
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.registry import Registry

_ROOM = "laploop.control.controllers"

CONTROLLERS: Registry[Callable[..., TipController]] = Registry(
    "controller",
    "laploop.controllers",
    {
        "reach": f"{_ROOM}.reach:ReachController.of",
        "track": f"{_ROOM}.track:TrackController.of",
        "palpate": f"{_ROOM}.palpate:PalpateController.of",
        "scan": f"{_ROOM}.scan:ScanController.of",
        "look": f"{_ROOM}.look:LookController.of",
        "image-servo": f"{_ROOM}.image_servo:ImageServoController.of",
    },
)
"""An entry is called with the rig and the user's arguments by name, and with `predictor` if a prediction is given."""


def make_controller(
    name: str,
    rig: Rig,
    *,
    prediction: str | MotionPredictor | None = None,
    prediction_arguments: Mapping[str, Any] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> TipController:
    """Make a controller for a camera.

    Args:
        name: A registered name, or `module:Class` of a class that is called with the rig.
        rig: The camera and its projector.
        prediction: How the age of the depth is bridged, by name or as an object; None leaves it to the controller.
        prediction_arguments: What the named predictor takes, by name.
        arguments: What the controller takes, by name; for the scripted ones, the fields of their configuration.

    Raises:
        UnknownNameError: If nobody registered a name.
        InvalidValueError: If an object cannot be imported, does not take the arguments, or is not what it should be.
    """
    given = dict(arguments or {})
    if isinstance(prediction, str):
        prediction = make_predictor(prediction, prediction_arguments)
    if prediction is not None:
        given["predictor"] = prediction
    made = CONTROLLERS.make(name, rig, **given)
    if not isinstance(made, TipController):
        raise InvalidValueError("controller", name, f"one with reset and command; it made a {type(made).__name__}")
    return made
