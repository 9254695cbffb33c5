"""The theatre from outside, by the ray caster: arms, stage and tissue, without OpenGL."""

import copy
import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.sensors.tracing.scene_geometry import geom_opacity
from laploop.perception.geometry import Rig, invert_transform, transform_points

if TYPE_CHECKING:
    from laploop.envs.theatre.theatre import Theatre

_FOV_RAD = math.radians(50.0)
_EYE_FROM_TISSUE = (0.2, -1.08, 0.46)
_AIM_FROM_TISSUE = (0.07, 0.0, 0.25)
"""Metres; where the theatre's view of a recording looks from and at, too."""
_HIDDEN_GROUP = 5
_AMBIENT = 0.35
_COLORS = np.zeros((max(ObjectId) + 1, 3))
_COLORS[ObjectId.BACKGROUND] = (246, 246, 246)
_COLORS[ObjectId.TISSUE] = (222, 146, 132)
_COLORS[ObjectId.TOOL] = (120, 130, 145)
_COLORS[ObjectId.STAGE] = (85, 88, 94)
_COLORS[ObjectId.OTHER] = (150, 160, 172)


class Overview:
    """A camera outside that sees what carries arms and shafts, too; the abdominal wall, which would hide all, is left out."""

    def __init__(self, theatre: "Theatre", *, width: int, height: int) -> None:
        """Look at a theatre; width and height are even numbers of pixels."""
        optics = ScopeOptics(width=width, height=height, fov_rad=_FOV_RAD)
        self._theatre = theatre
        self._camera = RayCamera(Rig.from_optics(optics))
        model = copy.deepcopy(theatre.model)
        model.geom_group[geom_opacity(model) < 1.0] = _HIDDEN_GROUP
        self._camera.attach(model, tissue=theatre.tissue, groups=(1, 2))
        middle = theatre.tissue.surface_points().mean(axis=0)
        self._world_from_camera = _looking(middle + _EYE_FROM_TISSUE, middle + _AIM_FROM_TISSUE)

    def picture(self) -> NDArray[np.uint8]:
        """Return the theatre as it is now, RGB, (height, width, 3), lit from the camera; its kinematics must be fresh."""
        view = self._camera.exact(self._theatre.data, self._world_from_camera)
        # Triangles of rigid bodies need not face outwards.
        facing = np.abs(np.nan_to_num((view.normals * self._camera.rig.camera.rays).sum(axis=-1)))
        facing /= np.linalg.norm(self._camera.rig.camera.rays, axis=-1)
        shade = np.where(view.object_id == ObjectId.BACKGROUND, 1.0, _AMBIENT + (1.0 - _AMBIENT) * facing)
        return np.clip(_COLORS[view.object_id] * shade[..., None], 0.0, 255.0).astype(np.uint8)

    def pixel(self, point_in_world: Array) -> tuple[int, int]:
        """Return column and row at which a point, (3,) metres, is seen, hidden or not."""
        camera = self._camera.rig.camera
        x, y, z = transform_points(invert_transform(self._world_from_camera), point_in_world)
        return int(camera.fx * x / z + camera.cx), int(camera.fy * y / z + camera.cy)

    def close(self) -> None:
        """End the camera's threads."""
        self._camera.close()


def _looking(eye: Array, aim: Array) -> Array:
    """Return the pose, 4x4, of a camera at one point that looks at another, both (3,), with the world's z upwards."""
    forward = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = eye
    return pose
