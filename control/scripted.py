"""The scripted controllers by the name of their task."""

from collections.abc import Callable

from laploop.control.look_controller import LookController
from laploop.control.messages import TipController
from laploop.control.palpate_controller import PalpateController
from laploop.control.reach_controller import ReachController
from laploop.control.scan_controller import ScanController
from laploop.control.track_controller import TrackController
from laploop.errors import UnknownNameError
from laploop.perception.geometry import Rig

_CONTROLLERS: dict[str, Callable[[Rig], TipController]] = {
    "reach": ReachController,
    "track": TrackController,
    "palpate": PalpateController,
    "scan": ScanController,
    "look": LookController,
}


def make_controller(task: str, rig: Rig) -> TipController:
    """Make the scripted controller of a task for a camera.

    Raises:
        UnknownNameError: If no task has that name.
    """
    if task not in _CONTROLLERS:
        raise UnknownNameError("task", task, _CONTROLLERS)
    return _CONTROLLERS[task](rig)
