"""What the controllers are told and what they answer."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from laploop.perception.messages import DepthFrame

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlInput:
    """All that a tip controller may know at a control tick; positions in metres, in the computer-vision camera's frame.

    The tip is the centre of the probe's ball end, and touching a surface point p with unit normal n (towards the camera)
    means a tip at `p + tip_radius_m * n`.
    """

    now_ns: int
    depth: DepthFrame | None
    """The newest frame that has arrived, or None before the first."""
    target_pixel: Array
    """(2,), the pixel (u, v) chosen in the first frame; pixel centres at +0.5."""
    tip_in_camera: Array
    """(3,), from the tool arm's kinematics."""
    tip_velocity_in_camera: Array
    """(3,), m/s."""
    trocar_in_camera: Array
    """(3,), where the tool's shaft passes the wall."""
    contact_force_n: float
    """Magnitude of what the tip's sensor reads, in newtons."""


class TipController(Protocol):
    """Anything that turns what is known into a desired velocity of the tool tip."""

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        ...

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame."""
        ...
