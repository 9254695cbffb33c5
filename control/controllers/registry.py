"""The scripted controllers by the name of their task."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from laploop.control.controllers.look import LookController, LookControllerConfig
from laploop.control.controllers.palpate import PalpateController, PalpateControllerConfig
from laploop.control.controllers.reach import ReachController, ReachControllerConfig
from laploop.control.controllers.scan import ScanController, ScanControllerConfig
from laploop.control.controllers.track import TrackController, TrackControllerConfig
from laploop.control.messages import TipController
from laploop.control.targeting.targeting import PredictionName
from laploop.errors import UnknownNameError
from laploop.perception.geometry import Rig

_CONTROLLERS: dict[str, tuple[Callable[[Rig, Any], TipController], Callable[[], Any]]] = {
    "reach": (ReachController, ReachControllerConfig),
    "track": (TrackController, TrackControllerConfig),
    "palpate": (PalpateController, PalpateControllerConfig),
    "scan": (ScanController, ScanControllerConfig),
    "look": (LookController, LookControllerConfig),
}
"""Controller and configuration."""


def make_controller(task: str, rig: Rig, prediction: PredictionName | None = None) -> TipController:
    """Make the scripted controller of a task for a camera.

    Args:
        task: Its name.
        rig: The camera and its projector.
        prediction: How the age of the depth is bridged; None leaves it to the controller.

    Raises:
        UnknownNameError: If no task or prediction has that name.
    """
    if task not in _CONTROLLERS:
        raise UnknownNameError("task", task, _CONTROLLERS)
    controller, configuration = _CONTROLLERS[task]
    config = configuration()
    if prediction is not None:
        config = replace(config, targeting=replace(config.targeting, prediction=prediction))
    return controller(rig, config)
