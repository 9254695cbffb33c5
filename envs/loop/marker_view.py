"""Where the target's marker appears in a frame."""

import numpy as np

from laploop.arrays import Array
from laploop.envs.loop.perception_server import CapturedFrame
from laploop.envs.sensors.object_id import ObjectId
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points

COVERED_MM = 3.0
"""A point so far behind what its pixel shows is not seen."""


def visible_pixel(captured: CapturedFrame, point_in_world: Array, world_from_camera: Array, camera: Intrinsics) -> Array | None:
    """Return where a point of the tissue, (3,), appears in a frame, (2,), or None where it is out of view or covered."""
    point = transform_points(invert_transform(world_from_camera), point_in_world)
    if point[2] <= 0.0:
        return None
    pixel = camera.project(point)
    column, row = int(np.floor(pixel[0])), int(np.floor(pixel[1]))
    if not (0 <= column < camera.width and 0 <= row < camera.height):
        return None
    # Deeper than what the pixel shows by more than the tissue's slope explains: something is in front of it.
    covered = captured.truth.object_id[row, column] != ObjectId.TISSUE
    covered = covered or point[2] * 1e3 - float(captured.truth.depth_mm[row, column]) > COVERED_MM
    return None if covered else pixel
