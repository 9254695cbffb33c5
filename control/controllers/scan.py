"""Following a path on the tissue at a constant stand-off."""

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from laploop.control.controllers.safe_approach import SafeApproach, SafeApproachConfig
from laploop.control.controllers.scan_path import ScanPath
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.control.vectors import length
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthFrame

Array = NDArray[np.float64]


class ScanPhase(StrEnum):
    """What the controller does once it is at the stand-off."""

    LOWER = "lower"
    """From the approach's stand-off to the scan's, over the place on the path where it goes on."""
    SCAN = "scan"
    """Along the path."""
    DONE = "done"
    """Beyond the end of the path, at the stand-off."""


@dataclass(frozen=True, kw_only=True)
class ScanControllerConfig:
    """Distances and speeds of `ScanController`."""

    targeting: TargetingConfig = field(default_factory=lambda: TargetingConfig(prediction="rhythms"))
    approach: SafeApproachConfig = field(default_factory=SafeApproachConfig)
    standoff_m: float = 0.003
    """Between the surface and the ball end, along the normal."""
    approach_speed_mps: float = 0.010
    """Along the normal, relative to the tissue."""
    scan_speed_mps: float = 0.008
    """Along the path, relative to the tissue."""
    full_speed_error_m: float = 0.0005
    """With an error up to this the scan goes on at full speed."""
    waiting_error_m: float = 0.002
    """With an error from this on it waits for the tip."""
    overrun_m: float = 0.002
    """So far it goes on beyond the end. A normal 10 degrees off puts a tip at the stand-off 0.8 mm off along the
    path; without going on, the last of the path might then never be under the tip."""
    min_seen_share: float = 0.8
    """Share of the path's pixels that a frame must show for the path to be laid."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number is not finite and above 0, or two that belong together are not in order.
        """
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not 0.0 < value < math.inf:
                raise InvalidValueError(name, value, "finite and above 0")
        if not self.full_speed_error_m < self.waiting_error_m:
            allowed = f"above full_speed_error_m ({self.full_speed_error_m})"
            raise InvalidValueError("waiting_error_m", self.waiting_error_m, allowed)
        if self.min_seen_share > 1.0:
            raise InvalidValueError("min_seen_share", self.min_seen_share, "at most 1")
        farthest = self.approach.distances.standoff_m
        if self.standoff_m > farthest:
            raise InvalidValueError("standoff_m", self.standoff_m, f"at most the approach's, {farthest}")


class ScanController:
    """A `TipController` that leads the ball end along a path at a stand-off over the surface.

    The first frame that shows target and path lays the path onto the surface, with a robust fit under each of its pixels;
    newer frames move it with the tissue. The tip stays on the normal through the foot on the path. The shaft's own direction
    is not free under a trocar: tip and trocar fix it.
    """

    def __init__(self, rig: Rig, config: ScanControllerConfig | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry, and a predictor to use in place of the one that the config names."""
        self._config = config = config or ScanControllerConfig()
        self._targeting = Targeting(rig, config.targeting, predictor)
        self._approach = SafeApproach(config.approach)
        self.reset()

    @property
    def phase(self) -> str:
        """What the controller is doing: a phase of the approach, or one of `ScanPhase`."""
        return self._approach.phase.value if self._phase is None else self._phase.value

    @property
    def target(self) -> Target | None:
        """What is known of the place on the path where the scan is, from the last tick."""
        return self._target

    @property
    def progress(self) -> float:
        """Share of the path that is behind, 0 to 1."""
        return 0.0 if self._path is None else min(1.0, self._along / self._path.length_m)

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._targeting.reset()
        self._approach.reset()
        self._target: Target | None = None
        self._path: ScanPath | None = None
        self._tried_ns = -1
        self._phase: ScanPhase | None = None
        self._along = 0.0
        self._height = 0.0
        self._last_ns: int | None = None

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame.

        Raises:
            InvalidValueError: If there is no path, or one of other than two or more finite pixels.
        """
        pixels = _checked(state.path_pixels)
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        seen = self._lay(pixels, state) if self._path is None else self._targeting.update(state)
        self._target = None if seen is None or self._path is None else self._foot(seen, self._path)
        velocity = self._approach.advance(state, self._target)
        if velocity is not None or self._target is None or self._path is None:
            self._phase = None
            return np.zeros(3) if velocity is None else velocity
        return self._work(state, self._target, self._path, elapsed)

    def _lay(self, pixels: Array, state: ControlInput) -> Target | None:
        """Lay the path in a frame that has not been tried; return the target if that succeeds."""
        frame = state.depth
        if frame is None or frame.captured_ns <= self._tried_ns:
            return None
        self._tried_ns = frame.captured_ns
        self._targeting.reset()
        seen = self._targeting.update(state)
        if seen is not None:
            self._path = self._laid(pixels, frame, state)
        return seen

    def _laid(self, pixels: Array, frame: DepthFrame, state: ControlInput) -> ScanPath | None:
        patches = [self._targeting.surface_at(pixel, frame, state) for pixel in pixels]
        found = [patch for patch in patches if patch is not None]
        if len(found) < max(2.0, self._config.min_seen_share * len(pixels)):
            return None
        return ScanPath(found)

    def _foot(self, seen: Target, path: ScanPath) -> Target:
        """Return the place on the path where the scan is, moved as the tissue around the target has."""
        point, normal = path.place(self._along)
        return replace(seen, point=point + self._moved(seen), normal=normal)

    def _moved(self, seen: Target) -> Array:
        reference = self._targeting.reference
        return np.zeros(3) if reference is None else seen.point - reference.point

    def _work(self, state: ControlInput, foot: Target, path: ScanPath, elapsed: float) -> Array:
        config, motion = self._config, self._config.approach.motion
        radius = config.approach.distances.shaft.tip_radius_m
        if self._phase is None:
            self._phase = ScanPhase.LOWER
            self._height = max(float((state.tip_in_camera - foot.point) @ foot.normal) - radius, config.standoff_m)
        lowered = max(self._height - config.approach_speed_mps * elapsed, config.standoff_m)
        feed_forward = foot.velocity
        if elapsed > 0.0:
            feed_forward = feed_forward - (self._height - lowered) / elapsed * foot.normal
        self._height = lowered
        way = foot.point + (radius + lowered) * foot.normal - state.tip_in_camera
        error = length(way)
        if self._phase is ScanPhase.LOWER and lowered <= config.standoff_m and error < config.full_speed_error_m:
            self._phase = ScanPhase.SCAN
        if self._phase is ScanPhase.SCAN:
            share = (config.waiting_error_m - error) / (config.waiting_error_m - config.full_speed_error_m)
            speed = config.scan_speed_mps * min(max(share, 0.0), 1.0)
            ahead = path.above(self._along + 0.001, radius + lowered) - path.above(self._along, radius + lowered)
            feed_forward = feed_forward + 1e3 * speed * ahead
            end = path.length_m + config.overrun_m
            self._along = min(self._along + speed * elapsed, end)
            if self._along >= end:
                self._phase = ScanPhase.DONE
        return motion.bounded(feed_forward + motion.back(way, lead_ns=state.lead_ns))


def _checked(pixels: Array | None) -> Array:
    if pixels is None or pixels.ndim != 2 or pixels.shape[1] != 2 or len(pixels) < 2 or not np.isfinite(pixels).all():
        shown = None if pixels is None else pixels.tolist()
        raise InvalidValueError("path_pixels", shown, "2 or more finite pixels (u, v) in the first frame")
    return pixels
