"""Hard frames: the instrument across the view, and light that saturates many pixels or leaves them dark."""

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
"""Grey values above and below which a pixel carries next to no information."""

LARGE_TOOL_FRACTION = 0.30
"""Smallest fraction of the view covered by an instrument that counts as large."""

_TRIES = 40
_LEAST_ELECTRONS = 0.05
_LARGE_TOOL_TILT_RAD = (math.radians(50.0), math.radians(80.0))
_LARGE_TOOL_DEPTH_M = (0.016, 0.032)
_LARGE_TOOL_BEYOND = (0.1, 0.6)
"""How far the tip lies beyond the middle of the image, as a tangent."""


def place_large_tool(
    scene: TrainingScene,
    camera: StripeCamera,
    pose: CameraPose,
    rng: np.random.Generator,
    smallest: float = LARGE_TOOL_FRACTION,
) -> float:
    """Put the instrument across the view, close enough to the camera to cover a fraction of it.

    Args:
        scene: Holds the instrument.
        camera: Sees it.
        pose: Of the camera.
        rng: Source of the instrument's poses.
        smallest: Fraction of the view to cover.

    Returns:
        The fraction covered; the largest of all tries where none reaches `smallest`.
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
        fraction = float(np.mean(seen == int(ObjectId.TOOL)))
        if fraction > largest:
            best, largest = (tip, axis), fraction
        if fraction >= smallest:
            break
    scene.place_tool(*best)
    return largest


def ill_exposure(electrons: NDArray[np.float32], optics: StripeOptics, fraction: float, *, saturated: bool) -> StripeOptics:
    """Return the optics with the LED power that saturates a fraction (0 to 1) of the pixels, or leaves it dark.

    `electrons` are those expected of every pixel with `optics`, proportional to the power.
    """
    grey, quantile = (SATURATED_GREY, 1.0 - fraction) if saturated else (DARK_GREY, fraction)
    wanted = optics.response.signal(grey / 255.0) * optics.full_well_electrons
    factor = wanted / max(float(np.quantile(electrons, quantile)), _LEAST_ELECTRONS)
    power = min(10.0, optics.led_power_w * factor)
    return replace(optics, led_power_w=power)
