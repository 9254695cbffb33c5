"""What controllers know at a control tick, and what they return."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from laploop.arrays import Array
from laploop.perception.messages import DepthFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class ControlInput:
    """Everything that a tip controller may know at a control tick; positions in metres, in the camera's frame.

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
    """Magnitude of the tip sensor's reading, in newtons."""
    contact_force_in_camera: Array | None = None
    """(3,), the sensor's reading, along the camera's axes."""
    shaft_axis_in_camera: Array | None = None
    """(3,), unit, along the tool's shaft from the trocar to the tip."""
    scope_trocar_in_camera: Array | None = None
    """(3,), where the scope's own shaft passes the wall."""
    world_from_camera: Array | None = None
    """4x4, the camera's pose now, from the camera arm's kinematics; `depth` holds its pose at capture."""
    lead_ns: int = 0
    """Delay and lag of the arm from a command to its motion; predictors look ahead across it."""
    path_pixels: Array | None = None
    """(n, 2), the line drawn in the first frame, for the task that follows one."""
    marker_pixel: Array | None = None
    """(2,), where the marker painted on the target appears in the frame of `depth`; None if it does not, or there is none."""
    working_distance_m: float = 0.085
    """Distance at which the camera should keep its target, for the task that moves the camera."""


@runtime_checkable
class TipController(Protocol):
    """Turns what is known at a control tick into a desired velocity of a tip."""

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        ...

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame.

        The tip is the tool's, or the scope's where the task moves the camera.
        """
        ...
