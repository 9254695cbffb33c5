"""What varies between training frames: pose, instrument, light, surfaces, sensor noise."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.assets.ranges import Span, check_ordered
from laploop.configuration import Field, configuration
from laploop.envs.sensors.optics.presets import OpticsRanges, draw_light, randomised_surfaces
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

_TRIES = 1000
_CLEAR_FRACTION = 0.6
"""Largest clearance, as a fraction of the distance between the camera and the most tilted shaft through the axis. Lobes come
nearer than the mean height."""


Distance = Annotated[float, Field(ge=0.03, le=0.3)]
ToolTilt = Annotated[float, Field(ge=0.0, le=1.4)]
HoverHeight = Annotated[float, Field(ge=0.0, le=0.1)]
PressDepth = Annotated[float, Field(ge=0.0, le=0.006)]


@configuration
class FrameRanges(OpticsRanges):
    """Ranges, drawn from evenly unless stated otherwise.

    In half of the frames the light is multiplied by the squared distance as well, as an automatic exposure does.
    """

    working_distance_m: Span[Distance] = (0.055, 0.150)
    """From the camera to the mean height of the tissue."""
    usual_distance_m: Span[Distance] = (0.070, 0.110)
    """Half of the frames are taken from this range, in which the loop works."""
    shift_m: Annotated[float, Field(ge=0.0, le=0.05)] = 0.020
    """Largest sideways shift of the tissue, along either axis."""
    tilt_rad: Annotated[float, Field(ge=0.0, le=0.6)] = math.radians(10.0)
    """Largest tilt of the tissue against the camera."""
    tool_tilt_rad: Span[ToolTilt] = (math.radians(28.0), math.radians(58.0))
    """Angle between the instrument's shaft and the camera's axis."""
    tool_azimuth_rad: Annotated[float, Field(ge=0.0, le=3.15)] = math.radians(40.0)
    """Most instruments come in from the camera's right, up to this angle off; one in five from anywhere."""
    tool_clearance_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.025
    """Smallest distance between the shaft's axis and the camera."""
    hover_m: Span[HoverHeight] = (0.0, 0.045)
    """Height of a hovering tip above the tissue; squared distribution, so that low heights are frequent."""
    press_m: Span[PressDepth] = (0.0005, 0.0035)
    """Depth of a pressing tip below the resting surface; one instrument in four presses."""

    def __post_init__(self) -> None:
        check_ordered(self)
        nearest = min(self.working_distance_m[0], self.usual_distance_m[0])
        largest = _CLEAR_FRACTION * nearest * math.sin(self.tool_tilt_rad[1])
        if self.tool_clearance_m > largest:
            allowed = f"at most {largest:.3g} with this working_distance_m and tool_tilt_rad"
            raise InvalidValueError("tool_clearance_m", self.tool_clearance_m, allowed)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraPose:
    """Pose of the camera."""

    working_distance_m: float
    world_from_camera: Array
    """4x4, computer-vision camera; world as in `TrainingScene`."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPose:
    """Pose of the instrument in the scene's world."""

    tip: Array
    """(3,), centre of the ball end."""
    axis: Array
    """(3,), unit vector along the shaft to the tip."""
    presses: bool


def draw_camera(ranges: FrameRanges, mean_height_m: float, rng: np.random.Generator) -> CameraPose:
    """Draw a camera above the tissue, turned about the vertical by any angle."""
    span = ranges.usual_distance_m if rng.random() < 0.5 else ranges.working_distance_m
    distance = float(rng.uniform(*span))
    yaw, direction = rng.uniform(0.0, 2.0 * math.pi, size=2)
    tilt = rng.uniform(0.0, ranges.tilt_rad)
    lean = _rotation(np.array([math.cos(direction), math.sin(direction), 0.0]), tilt)
    rotation = _rotation(np.array([0.0, 0.0, 1.0]), yaw) @ lean @ np.diag([1.0, -1.0, -1.0])
    seen = np.array([*rng.uniform(-ranges.shift_m, ranges.shift_m, size=2), mean_height_m])
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = seen - distance * rotation[:, 2]
    return CameraPose(working_distance_m=distance, world_from_camera=pose)


def draw_tool(
    ranges: FrameRanges, camera: CameraPose, surface: Array, *, tip_radius_m: float, rng: np.random.Generator
) -> ToolPose:
    """Draw an instrument whose tip is in view, on or above one of the `surface` points (n, 3), its shaft clear of the scope.

    Where no try is clear of it, the one farthest from the camera is returned.
    """
    tried = []
    for _ in range(_TRIES):
        tool = _try_tool(ranges, camera, surface, tip_radius_m=tip_radius_m, rng=rng)
        to_camera = camera.world_from_camera[:3, 3] - tool.tip
        outward = max(0.0, float(-tool.axis @ to_camera))
        distance = float(np.linalg.norm(to_camera + outward * tool.axis))
        if distance >= ranges.tool_clearance_m:
            return tool
        tried.append((distance, tool))
    return max(tried, key=lambda found: found[0])[1]


def _try_tool(
    ranges: FrameRanges, camera: CameraPose, surface: Array, *, tip_radius_m: float, rng: np.random.Generator
) -> ToolPose:
    rotation, centre = camera.world_from_camera[:3, :3], camera.world_from_camera[:3, 3]
    in_camera = (surface - centre) @ rotation
    aim = rng.uniform(-0.36, 0.36, size=2)
    touched = int(np.argmin(np.sum((in_camera[:, :2] / in_camera[:, 2:] - aim) ** 2, axis=1)))
    tilt = rng.uniform(*ranges.tool_tilt_rad)
    spread = math.pi if rng.random() < 0.2 else ranges.tool_azimuth_rad
    azimuth = rng.uniform(-spread, spread)
    along = np.array([math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), -math.cos(tilt)])
    axis = -rotation @ along
    presses = bool(rng.random() < 0.25)
    if presses:
        tip = surface[touched] + axis * rng.uniform(*ranges.press_m)
    else:
        low, high = ranges.hover_m
        highest = max(low, min(high, in_camera[touched, 2] - 0.035))
        tip = surface[touched] - rotation[:, 2] * (tip_radius_m + low + (highest - low) * rng.random() ** 2)
    return ToolPose(tip=tip, axis=axis, presses=presses)


def draw_optics(ranges: FrameRanges, working_distance_m: float, rng: np.random.Generator) -> StripeOptics:
    """Draw light, surfaces and sensor."""
    nominal = StripeOptics()
    light = draw_light(rng, ranges)
    if rng.random() < 0.5:
        light *= (working_distance_m / 0.085) ** 2
    return randomised_surfaces(replace(nominal, led_power_w=nominal.led_power_w * light), rng, ranges)


def _rotation(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit vector by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross)
