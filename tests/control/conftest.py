"""A tool arm under its trocar, and tissue in closed form to reach for."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import INSTRUMENT
from laploop.control.arm.model import ArmModel
from laploop.control.arm.start_posture import start_posture
from laploop.control.messages import ControlInput
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


def breathing_and_beating(time_s):
    """Return a displacement in metres: 10 mm at 0.25 Hz, 1 mm at 1.2 Hz, both from end to end."""
    return 0.005 * np.sin(2.0 * np.pi * 0.25 * time_s + 0.4) + 0.0005 * np.sin(2.0 * np.pi * 1.2 * time_s)


@dataclass
class PlantLog:
    """What happened, one entry a tick."""

    times: list[float] = field(default_factory=list)
    tips: list[np.ndarray] = field(default_factory=list)
    commands: list[np.ndarray] = field(default_factory=list)
    forces: list[float] = field(default_factory=list)
    gaps: list[float] = field(default_factory=list)
    """Of the ball from the surface at the target along its normal, metres, negative when pressed in."""
    sideways: list[float] = field(default_factory=list)
    """Distance of the tip from the normal through the target, metres."""
    phases: list[str] = field(default_factory=list)

    def since(self, time_s, values):
        """Return the entries from a time on."""
        return np.array([value for time, value in zip(self.times, values, strict=True) if time >= time_s])

    @property
    def phase_order(self):
        return [phase for phase, before in zip(self.phases, [None, *self.phases], strict=False) if phase != before]


class PlanePlant:
    """A tip that integrates its velocity, late if wished, over a plane of tissue that moves along the optical axis.

    Tissue pushes back with a spring; nothing else of the world is there.
    """

    TICK_NS = 8_000_000
    FRAME_NS = 40_000_000

    def __init__(self, rig, *, slope=(0.15, -0.1), stiffness=250.0, latency_ns=40_000_000, late_ticks=0):
        self.rig, self.stiffness, self.latency_ns, self.late_ticks = rig, stiffness, latency_ns, late_ticks
        self.pixel = np.array([140.5, 120.5])
        self.normal = np.array([slope[0], slope[1], -1.0]) / np.linalg.norm([slope[0], slope[1], 1.0])
        self.centre = rig.camera.unproject(self.pixel, 0.1)
        self.start = np.array([0.04, -0.01, 0.045])
        self.trocar = np.array([0.17, 0.0, -0.11])
        self.motion = lambda _: 0.0
        self.spoil = lambda _, depth, valid: (depth, valid)
        """Changes a frame, or loses it by returning None."""
        self.sensor = lambda _, force: force
        self.limit = lambda velocity, tip: velocity
        self.path = None

    def depth(self, moved):
        return (self.normal @ (self.centre + [0.0, 0.0, moved])) / (self.rig.camera.rays @ self.normal)

    def run(self, controller, seconds):
        log, on_the_way, newest, tip = PlantLog(), [], None, self.start.copy()
        queue = deque([np.zeros(3)] * self.late_ticks)
        velocity = np.zeros(3)
        for tick in range(round(seconds * 125)):
            now_ns = tick * self.TICK_NS
            time_s = now_ns * 1e-9
            moved = self.motion(time_s) - self.motion(0.0)
            if now_ns % self.FRAME_NS == 0:
                spoiled = self.spoil(time_s, self.depth(moved), np.ones(self.rig.camera.rays.shape[:2], dtype=bool))
                if spoiled is not None:
                    frame = depth_frame(
                        spoiled[0], index=tick, captured_ns=now_ns, latency_ns=self.latency_ns, valid=spoiled[1]
                    )
                    on_the_way.append(frame)
            while on_the_way and on_the_way[0].available_ns <= now_ns:
                newest = on_the_way.pop(0)
            surface = self.centre + [0.0, 0.0, moved]
            gap = float((tip - surface) @ self.normal) - INSTRUMENT.tip_radius_m
            force = self.stiffness * max(-gap, 0.0)
            command = controller.command(
                ControlInput(
                    now_ns=now_ns,
                    depth=newest,
                    target_pixel=self.pixel,
                    tip_in_camera=tip.copy(),
                    tip_velocity_in_camera=velocity,
                    trocar_in_camera=self.trocar,
                    contact_force_n=self.sensor(time_s, force),
                    lead_ns=self.late_ticks * self.TICK_NS,
                    path_pixels=self.path,
                )
            )
            assert np.isfinite(command).all()
            log.times.append(time_s)
            log.tips.append(tip.copy())
            log.commands.append(command)
            log.forces.append(force)
            log.gaps.append(gap)
            across = tip - surface - ((tip - surface) @ self.normal) * self.normal
            log.sideways.append(float(np.linalg.norm(across)))
            log.phases.append(str(getattr(controller, "phase", "")))
            queue.append(command)
            velocity = self.limit(queue.popleft(), tip)
            tip = tip + velocity * self.TICK_NS * 1e-9
        return log


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


@pytest.fixture(scope="session")
def make_plant(rig):
    return lambda **options: PlanePlant(rig, **options)


@pytest.fixture(scope="session")
def breathing():
    return breathing_and_beating
