"""A tool arm under its trocar, and tissue in closed form to reach for."""

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import INSTRUMENT
from laploop.control.robot import ArmModel
from laploop.control.start_posture import start_posture
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate, DepthFrame

# The camera looks straight down from 130 mm above the world's origin.
WORLD_FROM_CAMERA = np.diag([1.0, -1.0, -1.0, 1.0])
WORLD_FROM_CAMERA[2, 3] = 0.13


class ToolArm:
    """The arm at +x whose shaft leans by 42 degrees; its tip starts 45 mm beside the optical axis, above all tissue."""

    def __init__(self):
        world_from_base = np.diag([-1.0, -1.0, 1.0, 1.0])
        world_from_base[0, 3] = 0.6
        self.model = ArmModel(world_from_base, INSTRUMENT)
        lean = np.radians(42.0)
        along = np.array([-np.sin(lean), 0.0, -np.cos(lean)])
        self.world_from_shaft = np.eye(4)
        self.world_from_shaft[:3, :3] = np.stack([np.cross([0.0, 1.0, 0.0], along), [0.0, 1.0, 0.0], along], axis=-1)
        self.world_from_shaft[:3, 3] = [0.035, 0.01, 0.085]
        self.trocar_in_world = self.world_from_shaft[:3, 3] - 0.23 * along
        self.home_q = start_posture(self.model, self.world_from_shaft, [0.0, -1.2, 1.2, -1.5, -1.5, 0.0])


class SphereOnPlane:
    """A sphere half sunk into a plane that faces the camera, both moving along the optical axis; camera frame, metres."""

    def __init__(self, rig, centre=(0.004, -0.003, 0.105), radius=0.015, floor=0.107):
        self.rig = rig
        self.centre = np.array(centre)
        self.radius = radius
        self.floor = floor

    def depth(self, moved=0.0):
        rays = self.rig.camera.rays
        centre = self.centre + [0.0, 0.0, moved]
        a = np.einsum("hwi,hwi->hw", rays, rays)
        b = rays @ centre
        discriminant = b * b - a * (centre @ centre - self.radius**2)
        sphere = np.where(discriminant > 0.0, (b - np.sqrt(np.maximum(discriminant, 0.0))) / a, np.inf)
        return np.minimum(sphere, self.floor + moved)

    def pixel(self, x, y):
        """Return the centre of the pixel that shows lateral position (x, y), at about the sphere's near side."""
        return np.floor(self.rig.camera.project(np.array([x, y, self.centre[2] - self.radius]))) + 0.5

    def surface_at(self, pixel):
        """Return point and outward normal under a pixel of the unmoved sphere."""
        column, row = int(pixel[0]), int(pixel[1])
        point = self.rig.camera.rays[row, column] * self.depth()[row, column]
        return point, (point - self.centre) / self.radius


def depth_frame(depth_m, *, index, captured_ns, latency_ns=40_000_000, valid=None):
    estimate = DepthEstimate(
        depth_mm=(1e3 * depth_m).astype(np.float32), valid=np.ones(depth_m.shape, dtype=bool) if valid is None else valid
    )
    return DepthFrame(
        index=index,
        estimate=estimate,
        captured_ns=captured_ns,
        available_ns=captured_ns + latency_ns,
        world_from_camera=WORLD_FROM_CAMERA,
    )


@pytest.fixture(scope="session")
def rig():
    return Rig.from_optics(ScopeOptics())


@pytest.fixture(scope="session")
def tool():
    return ToolArm()


@pytest.fixture
def sphere(rig):
    return SphereOnPlane(rig)


@pytest.fixture(scope="session")
def world_from_camera():
    return WORLD_FROM_CAMERA.copy()


@pytest.fixture(scope="session")
def make_frame():
    return depth_frame


@pytest.fixture(scope="session")
def make_sphere(rig):
    return lambda **options: SphereOnPlane(rig, **options)
