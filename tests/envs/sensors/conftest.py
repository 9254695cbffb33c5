"""Closed-form scenes for the sensors' tests."""

from collections.abc import Callable

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.perception.geometry import Rig

PlaneMaker = Callable[..., SceneGeometry]
PlateMaker = Callable[..., SceneGeometry]


@pytest.fixture(scope="session")
def rig() -> Rig:
    return Rig.from_optics(ScopeOptics())


@pytest.fixture(scope="module")
def camera(rig: Rig) -> StripeCamera:
    return StripeCamera(rig)


@pytest.fixture(scope="session")
def make_plane() -> PlaneMaker:
    def make(z: float, *, tilt_x: float = 0.0, tilt_y: float = 0.0, object_id: int = ObjectId.OTHER, half: float = 1.0):
        """Return the plane z = z0 + x tan(tilt_x) + y tan(tilt_y), seen along +z."""
        x, y = np.array([-half, half, half, -half]), np.array([-half, -half, half, half])
        points = np.stack([x, y, z + x * np.tan(tilt_x) + y * np.tan(tilt_y)], axis=1)
        return SceneGeometry(points=points, triangles=np.array([[0, 1, 2], [0, 2, 3]]), object_ids=object_id)

    return make


@pytest.fixture(scope="session")
def plate_before_wall(make_plane: PlaneMaker) -> PlateMaker:
    def make(plate_z: float = 0.06, *, plate_id: int = ObjectId.OTHER, half: float = 0.008):
        """Return a plate that faces the camera, before a wall at 0.1 m; it casts a shadow on that."""
        wall, plate = make_plane(0.1), make_plane(plate_z, half=half)
        return SceneGeometry(
            points=np.concatenate([wall.points, plate.points]),
            triangles=np.concatenate([wall.triangles, plate.triangles + 4]),
            object_ids=np.repeat([ObjectId.OTHER, plate_id], 2),
            parts=np.array([0, 0, 1, 1]),
        )

    return make
