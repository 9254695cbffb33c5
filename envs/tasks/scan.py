"""The scanning task: along a line on the tissue at a constant distance."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces

from laploop.arrays import Array
from laploop.assets.shafts import INSTRUMENT
from laploop.control.messages import ControlInput
from laploop.envs.tasks.configs import ScanConfig
from laploop.envs.tasks.measures import Samples, nearness
from laploop.envs.tasks.observations import Observation, bounded
from laploop.envs.tasks.path_choice import between, choose_path_pixels, evenly
from laploop.envs.tasks.steppable_env import Info
from laploop.envs.tasks.surface_point import PathFoot, SurfacePath, SurfacePoint
from laploop.envs.tasks.target_choice import checked_pixels
from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import InvalidValueError


class ScanEnv(TaskEnv[ScanConfig]):
    """Lead the ball end of the instrument 3 mm above a line that was drawn in the first frame, 60 mm long on the tissue.

    On tissue without room for that, such as an organ's tight loops, the line is as long as fits, 30 mm or more. It is
    material: it moves with the tissue. Its foot is the point of it nearest to the tip, at most 4 mm from the progress of the
    scan. The stand-off is the height of the ball's lowest point above the foot along the surface's normal. The incidence is
    the angle between that normal and the line from the foot to the tip: a straight shaft in its trocar cannot choose its
    direction, but its tip can face the surface squarely. `info` also has the shaft's own angle.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`, and

    | key | space | meaning |
    |---|---|---|
    | `path_pixels` | `Box(0, 256, (31, 2), float32)` | the line in the first frame, pixels (u, v), evenly spaced on tissue |
    | `path_progress` | `Box(0, 1, (1,), float32)` | how much of it has been scanned |

    `target_pixel` is the line's start; in the state mode, target position and normal are those of the foot.

    ## Reward

    `distance` (minus tanh of the tip's distance from its place above the foot over 20 mm), `progress` (mm scanned),
    `standoff` (minus tanh of the stand-off's error over 2 mm, while scanning), `contact` (minus 1 while the tip touches
    anything), `force`, `effort`, `success`, `harm` (`ScanRewardWeights`).

    ## End

    When the end of the line is reached, terminated with `success` if the stand-off's root mean square error was at most 1 mm
    and the mean incidence at most 10 degrees, with `inaccurate` if not; with `force` above 5 N; with `rcm` above 5 mm.
    Truncated with `time` after `max_seconds`.

    ## Options of `reset`

    `{"path_pixels": [(column, row), ...]}` draws the line by hand: two or more pixels of the first frame, at which the line
    may turn.

    ## Info

    Besides the keys of every task: `path_progress`, `standoff_error_mm`, `incidence_deg`, `shaft_incidence_deg`.
    """

    config_type: ClassVar[type[ScanConfig]] = ScanConfig
    reset_options: ClassVar[tuple[str, ...]] = ("path_pixels",)
    WINDOW_M: ClassVar[float] = 0.004
    """How far from the progress the foot is searched."""

    def extra_spaces(self) -> dict[str, spaces.Box]:
        """Return the spaces of path and progress."""
        camera = self.loop.rig.camera
        return {
            "path_pixels": spaces.Box(0.0, float(max(camera.width, camera.height)), (self.config.path.points, 2), np.float32),
            "path_progress": spaces.Box(0.0, 1.0, (1,), np.float32),
        }

    def extra_observation(self) -> Observation:
        """Return path and progress."""
        return {"path_pixels": self.path_pixels.astype(np.float32), "path_progress": bounded([self._progress()], 0.0, 1.0)}

    def choose_target(self, rng: np.random.Generator, options: Mapping[str, Any]) -> None:
        """Take the path of `options`, or draw one.

        Raises:
            InvalidValueError: If a pixel of the path lies outside the frame or shows no tissue.
        """
        camera, truth = self.loop.rig.camera, self.first_view()
        depth_m = truth.depth_mm.astype(np.float64) * 1e-3
        if "path_pixels" in options:
            drawn = checked_pixels("path_pixels", options["path_pixels"], camera)
            if len(drawn) < 2:
                raise InvalidValueError("path_pixels", drawn.tolist(), "2 or more pixels")
            # Straight in the image from pixel to pixel, and dense enough to follow the surface between them.
            places = np.linspace(0.0, len(drawn) - 1.0, 32 * (len(drawn) - 1) + 1)
            dense = between(drawn, places)
            if not np.isfinite(depth_m[dense[:, 1].astype(int), dense[:, 0].astype(int)]).all():
                raise InvalidValueError("path_pixels", drawn.tolist(), "a line that lies on the tissue")
            self.path_pixels = evenly(dense, depth_m, camera, self.config.path.points)
        else:
            self.path_pixels = choose_path_pixels(truth, camera, self.trocar_in_camera(), rng, self.config.path)
        theatre = self.loop.theatre
        world_from_camera = theatre.world_from_camera()
        halves = np.linspace(0.0, len(self.path_pixels) - 1.0, 2 * len(self.path_pixels) - 1)
        rays = camera.unproject(between(self.path_pixels, halves), 1.0) @ world_from_camera[:3, :3].T
        points, triangles = theatre.tissue.surface_points(), theatre.tissue.triangles
        self._path = SurfacePath.from_rays(points, triangles, world_from_camera[:3, 3], rays)
        self.set_target(SurfacePoint.from_ray(points, triangles, world_from_camera[:3, 3], rays[0]), self.path_pixels[0])
        self._foot = self._path.at(points, 0.0)

    def control_input(self) -> ControlInput:
        """Return everything that a tip controller may know now, the path included."""
        return replace(super().control_input(), path_pixels=self.path_pixels)

    def target_offset(self) -> tuple[Array, Array, Array]:
        """Return the way from the foot to the tip, the normal at the foot, and the foot, each (3,), in the world."""
        return self.loop.theatre.tip_in_world() - self._foot.position, self._foot.normal, self._foot.position

    def target_error_mm(self) -> float:
        """Return the distance of the tip from its place above the path."""
        offset, normal, _ = self.target_offset()
        return float(np.linalg.norm(offset - self._height_m() * normal)) * 1e3

    def measure(self, *, begin: bool) -> None:
        """Find the foot, and how well the tip stands over it."""
        config, points = self.config, self.loop.theatre.tissue.surface_points()
        if begin:
            self._along_m = self._gained_m = 0.0
            self._started = False
            self._standoff, self._incidence = Samples(), Samples()
        tip = self.loop.theatre.tip_in_world()
        if self._started:
            self._foot = self._path.nearest(points, tip, self._along_m - self.WINDOW_M, self._along_m + self.WINDOW_M)
        else:
            self._foot = self._path.at(points, 0.0)
        self._error_mm = self.target_error_mm()
        self._started = self._started or self._error_mm <= config.start_radius_m * 1e3
        before = self._along_m
        if self._started and self._error_mm <= config.lost_radius_m * 1e3:
            self._along_m = max(self._along_m, self._foot.along_m)
        self._gained_m = self._along_m - before
        self._measure_angles(self._foot, tip)
        if self._started and not begin:
            self._standoff.add(self._standoff_error_mm)
            self._incidence.add(self._incidence_deg)

    def is_assessed(self) -> bool:
        """Return whether the tip has reached the start of the path."""
        return self._started

    def ended_by(self) -> str | None:
        """Return how good the scan was, once it is at its end."""
        if self._progress() < 1.0:
            return None
        standoff, incidence = self._standoff.rms(), self._incidence.mean()
        accurate = standoff is not None and standoff <= self.config.max_rms_m * 1e3
        square = incidence is not None and incidence <= self._max_incidence_deg()
        return "success" if accurate and square else "inaccurate"

    def reward_terms(self) -> dict[str, float]:
        """Return distance, progress, error of the stand-off, and contact."""
        return {
            "distance": nearness(self._error_mm, 20.0),
            "progress": self._gained_m * 1e3,
            "standoff": nearness(abs(self._standoff_error_mm), 2.0) if self._started else 0.0,
            "contact": -float(self.loop.max_force_n > 0.0),
        }

    def task_info(self) -> Info:
        """Return errors and progress."""
        return {
            "target_error_mm": self._error_mm,
            "path_progress": self._progress(),
            "standoff_error_mm": self._standoff_error_mm,
            "incidence_deg": self._incidence_deg,
            "shaft_incidence_deg": self._shaft_incidence_deg,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return how much was scanned, and how well."""
        return {
            "path_progress": self._progress(),
            "path_length_mm": self._path.length_m * 1e3,
            "standoff_rms_mm": self._standoff.rms(),
            "incidence_mean_deg": self._incidence.mean(),
            "incidence_p95_deg": self._incidence.percentile(95),
            "incidence_within_share": self._incidence.fraction_up_to(self._max_incidence_deg()),
        }

    def _max_incidence_deg(self) -> float:
        return float(np.rad2deg(self.config.max_incidence_rad))

    def _progress(self) -> float:
        """Return the fraction of the path that was scanned; its last half millimetre counts as scanned."""
        return min(1.0, self._along_m / max(self._path.length_m - 0.0005, 1e-6))

    def _height_m(self) -> float:
        return self.config.standoff_m + INSTRUMENT.tip_radius_m

    def _measure_angles(self, foot: PathFoot, tip: Array) -> None:
        offset = tip - foot.position
        self._standoff_error_mm = (float(offset @ foot.normal) - self._height_m()) * 1e3
        self._incidence_deg = _angle_deg(offset, foot.normal)
        shaft = self.loop.theatre.world_from_shaft(self.loop.theatre.tool_arm)[:3, 2]
        self._shaft_incidence_deg = _angle_deg(-shaft, foot.normal)


def _angle_deg(vector: Array, unit: Array) -> float:
    cosine = float(vector @ unit) / max(float(np.linalg.norm(vector)), 1e-12)
    return float(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))
