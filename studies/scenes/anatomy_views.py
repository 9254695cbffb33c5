"""Where camera and instruments are in an anatomy scene."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.studies.scenes.anatomy_optics import AnatomyRanges
from laploop.studies.scenes.anatomy_scene import MOST_TOOLS, AnatomyScene, ToolPlacement
from laploop.studies.scenes.frame_conditions import CameraPose

Array = NDArray[np.float64]

_TRIES = 8
_LOOP_RANGE_M = (0.055, 0.150)
"""Depths that estimators are made for."""
_IN_RANGE = 0.6
"""Fraction of the view that should lie in that range."""
_NEAREST_M = 0.035
_AIM_M = 0.022
"""The camera looks at a point of the organ not farther than this from the middle."""
_SECOND_TOOL = 0.25
_NEAR_TOOL = 0.2
_NEAR_DEPTH_M = (0.015, 0.035)
_TOOL_TILT_RAD = (math.radians(25.0), math.radians(85.0))
_TOOL_CLEARANCE_M = 0.011
"""Between the camera and the axis of a shaft: half an 8 mm shaft and the scope's window."""
_TOOL_TRIES = 100


def draw_view(ranges: AnatomyRanges, scene: AnatomyScene, camera: StripeCamera, rng: np.random.Generator) -> CameraPose:
    """Draw a pose of the camera from which most of what it sees lies within the range of the loop.

    Of several tries the first with enough in range, else the best, is taken; frames from afar are taken as they come.
    """
    afar = rng.random() < ranges.far_fraction
    best = _try_view(ranges, scene, afar=afar, rng=rng)
    if afar:
        return best
    pose, most = best, -1.0
    for _ in range(_TRIES):
        depth_m = 1e-3 * camera.depth_view(camera.snapshot(None, pose.world_from_camera)).depth_mm
        low, high = _LOOP_RANGE_M
        in_range = float(np.mean((depth_m >= low) & (depth_m <= high)))
        if np.nanmin(depth_m, initial=1.0) < _NEAREST_M:
            in_range *= 0.1
        if in_range > most:
            best, most = pose, in_range
        if in_range >= _IN_RANGE:
            break
        pose = _try_view(ranges, scene, afar=False, rng=rng)
    return best


def _try_view(ranges: AnatomyRanges, scene: AnatomyScene, *, afar: bool, rng: np.random.Generator) -> CameraPose:
    span = ranges.usual_distance_m if rng.random() < 0.5 else ranges.working_distance_m
    distance = float(rng.uniform(*(ranges.far_distance_m if afar else span)))
    middle = 0.5 * (scene.tops.min(axis=0) + scene.tops.max(axis=0))
    central = scene.tops[np.linalg.norm((scene.tops - middle)[:, :2], axis=1) < _AIM_M]
    candidates = central if len(central) else scene.tops
    aim = candidates[rng.integers(len(candidates))]
    yaw, direction = rng.uniform(0.0, 2.0 * math.pi, size=2)
    tilt = rng.uniform(0.0, ranges.tilt_rad)
    lean = Rotation.from_rotvec(tilt * np.array([math.cos(direction), math.sin(direction), 0.0])).as_matrix()
    turn = Rotation.from_rotvec([0.0, 0.0, yaw]).as_matrix()
    pose = np.eye(4)
    pose[:3, :3] = lean @ turn @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = aim - distance * pose[:3, 2]
    return CameraPose(working_distance_m=distance, world_from_camera=pose)


def draw_tools(scene: AnatomyScene, camera: StripeCamera, pose: CameraPose, rng: np.random.Generator) -> list[ToolPlacement]:
    """Draw one or two instruments in view, on or before the surface; one in five comes close to the lens."""
    depth_m = 1e-3 * camera.depth_view(camera.snapshot(None, pose.world_from_camera)).depth_mm.astype(np.float64)
    count = MOST_TOOLS if rng.random() < _SECOND_TOOL else 1
    return [_draw_tool(scene.tip_radii_m[number], depth_m, camera, pose, rng) for number in range(count)]


def _draw_tool(
    tip_radius_m: float, depth_m: Array, camera: StripeCamera, pose: CameraPose, rng: np.random.Generator
) -> ToolPlacement:
    rotation, centre = pose.world_from_camera[:3, :3], pose.world_from_camera[:3, 3]
    height, width = depth_m.shape
    for _ in range(_TOOL_TRIES):
        row, column = (int(rng.uniform(0.15, 0.85) * size) for size in (height, width))
        behind = depth_m[row, column] if np.isfinite(depth_m[row, column]) else pose.working_distance_m
        if rng.random() < _NEAR_TOOL:
            depth = rng.uniform(*_NEAR_DEPTH_M)
        else:
            # Squared, so that tips are often close to the surface.
            depth = behind - 1.2 * tip_radius_m - (0.6 * behind) * rng.random() ** 2
        tip = max(depth, _NEAR_DEPTH_M[0]) * camera.intrinsics.rays[row, column]
        tilt, azimuth = rng.uniform(*_TOOL_TILT_RAD), rng.uniform(-math.pi, math.pi)
        out = np.array([math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), -math.cos(tilt)])
        # The point of the shaft's axis that is nearest to the camera.
        nearest = tip + max(0.0, float(-out @ tip)) * out
        if np.linalg.norm(nearest) >= _TOOL_CLEARANCE_M:
            break
    return ToolPlacement(tip=rotation @ tip + centre, axis=-rotation @ out)
