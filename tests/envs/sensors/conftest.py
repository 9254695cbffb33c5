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
