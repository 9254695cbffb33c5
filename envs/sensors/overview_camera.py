"""A picture of the whole theatre from the side, ray cast: no OpenGL, no display."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.instrument import VISIBLE_GROUP
from laploop.assets.operating_table import ABDOMINAL_WALL
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.ur5 import ARM_GROUP
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.geometry import Intrinsics, Rig, invert_transform, transform_points

_EYE_M = (0.30, -0.62, 0.44)
"""Where the picture is taken from, in the world: beside the table, above the wall."""
_LOOK_AT_M = (0.07, 0.0, 0.21)
"""The middle of the picture: between tissue and trocars."""
_FOV_RAD = math.radians(46.0)
_AMBIENT = 0.25
"""Brightness of a surface that is seen edge-on; the light stands beside the eye."""
_COLORS = {
    ObjectId.BACKGROUND: (27, 30, 36),
    ObjectId.TISSUE: (214, 120, 108),
    ObjectId.TOOL: (170, 196, 222),
    ObjectId.STAGE: (92, 96, 104),
    ObjectId.OTHER: (196, 198, 202),
}


class OverviewCamera:
    """Shows tissue, stage and both arms, without the abdominal wall, which would hide them."""

    def __init__(self, *, width: int, height: int, device: str = "cpu") -> None:
        """Allocate the buffers; see `RayCamera` for the device and errors."""
        intrinsics = Intrinsics.from_fov(width=width, height=height, fov_rad=_FOV_RAD)
        # Nobody looks at what its projector lights.
        self._camera = RayCamera(replace(Rig.from_optics(ScopeOptics()), camera=intrinsics), device)
        self._theatre: Theatre | None = None
        self._pose = _looking_at(np.array(_EYE_M), np.array(_LOOK_AT_M))
        self._palette = np.array([_COLORS[kind] for kind in sorted(ObjectId)], dtype=np.float32)

    def picture(self, theatre: Theatre) -> NDArray[np.uint8]:
        """Return a theatre as it is now, (height, width, 3) RGB."""
        if self._theatre is not theatre:
            self._camera.attach(
                theatre.model, tissue=theatre.tissue, groups=(VISIBLE_GROUP, ARM_GROUP), without=(ABDOMINAL_WALL,)
            )
            self._theatre = theatre
        view = self._camera.exact(theatre.data, self._pose)
        rays = self._camera.intrinsics.rays
        towards_eye = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        facing = np.nan_to_num((view.normals * towards_eye).sum(axis=-1))
        light = np.where(view.object_id == ObjectId.BACKGROUND, 1.0, _AMBIENT + (1.0 - _AMBIENT) * np.clip(facing, 0.0, 1.0))
        return np.asarray((self._palette[view.object_id] * light[..., None]).round().astype(np.uint8))

    def pixel(self, point_in_world: Array) -> tuple[int, int]:
        """Return column and row at which a point, (3,) metres, is seen, hidden or not."""
        column, row = self._camera.intrinsics.project(transform_points(invert_transform(self._pose), point_in_world))
        return int(column), int(row)

    def close(self) -> None:
        """End the threads."""
        self._camera.close()


def _looking_at(eye: Array, point: Array) -> Array:
    """Return the pose, 4x4 world_from_camera, of a computer-vision camera that is upright and looks at a point."""
    forward = (point - eye) / np.linalg.norm(point - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = eye
    return pose
