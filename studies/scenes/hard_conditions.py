"""Frames that are harder than most: the instrument across the view, and light that leaves many pixels saturated or dark."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.studies.scenes.frame_conditions import CameraPose
from laploop.studies.scenes.training_scene import TrainingScene

SATURATED_GREY, DARK_GREY = 253.0, 8.0
"""Grey values from which a pixel tells next to nothing, above and below."""

LARGE_TOOL_SHARE = 0.30
"""Least share of the view that the instrument covers where it is called large."""

_TRIES = 40
_LARGE_TOOL_TILT_RAD = (math.radians(50.0), math.radians(80.0))
_LARGE_TOOL_DEPTH_M = (0.016, 0.032)
_LARGE_TOOL_BEYOND = (0.1, 0.6)
"""How far beyond the image's middle the tip lies, as a tangent."""


def place_large_tool(
    scene: TrainingScene,
    camera: StripeCamera,
    pose: CameraPose,
    rng: np.random.Generator,
    least_share: float = LARGE_TOOL_SHARE,
) -> float:
    """Put the instrument across the view, so near to the camera that it covers `least_share`; return the share it covers.

    Where chance does not bring it that near, the largest share of all tries stays.
    """
    rotation, centre = pose.world_from_camera[:3, :3], pose.world_from_camera[:3, 3]
    best, largest = (np.zeros(3), np.zeros(3)), -1.0
    for _ in range(_TRIES):
        tilt, azimuth = rng.uniform(*_LARGE_TOOL_TILT_RAD), rng.uniform(-math.pi, math.pi)
        sideways = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
        depth, beyond = rng.uniform(*_LARGE_TOOL_DEPTH_M), rng.uniform(*_LARGE_TOOL_BEYOND)
        # The shaft comes in from one side, towards the camera, and its tip lies on the other side of the image's middle.
        tip = centre + rotation @ (depth * (np.array([0.0, 0.0, 1.0]) - beyond * sideways))
        axis = rotation @ (np.array([0.0, 0.0, math.cos(tilt)]) - math.sin(tilt) * sideways)
        scene.place_tool(tip, axis)
        seen = camera.exact(scene.data, pose.world_from_camera).object_id
        share = float(np.mean(seen == int(ObjectId.TOOL)))
        if share > largest:
            best, largest = (tip, axis), share
        if share >= least_share:
            break
    scene.place_tool(*best)
    return largest


def ill_exposure(electrons: NDArray[np.float32], optics: StripeOptics, share: float, *, saturated: bool) -> StripeOptics:
    """Return the optics with the LED's power that makes `share` of the pixels saturated, or dark.

    Args:
        electrons: Expected electrons of every pixel with `optics`; they are in proportion to the power.
        optics: The optics to change.
        share: From 0 to 1.
        saturated: Whether the pixels shall be saturated; dark otherwise.
    """
    grey = 255.0 * electrons / optics.full_well_electrons
    if saturated:
        factor = SATURATED_GREY / max(float(np.quantile(grey, 1.0 - share)), 1e-3)
    else:
        factor = DARK_GREY / max(float(np.quantile(grey, share)), 1e-3)
    power = min(10.0, optics.led_power_w * factor)
    return replace(optics, led_power_w=power)
