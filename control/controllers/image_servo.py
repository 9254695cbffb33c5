"""Plain image-based visual servoing of the scope, with or without a Smith predictor: a yardstick for delay in the loop."""

from collections import deque
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration, from_plain
from laploop.control.controllers.scope_motion import scope_tip_velocity
from laploop.control.controllers.tip_motion import limited
from laploop.control.messages import ControlInput
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthFrame


@configuration
class ImageServoConfig:
    """Gain and delay compensation of `ImageServoController`."""

    gain_per_s: Annotated[float, Field(gt=0.0, le=100.0)] = 4.0
    """Rate at which the target's place in the newest frame is driven to the middle."""
    compensation: Literal["none", "smith"] = "none"
    """What bridges the age of the frame: nothing, or a Smith predictor, which adds what the commands since then should have
    moved."""
    told_delay_s: Annotated[float, Field(ge=0.0, le=10.0)] | None = None
    """Age that a Smith predictor takes a frame to have when it arrives; by default its time stamp says so."""
    hold_distance: bool = True
    """Whether the target is driven to the working distance as well; otherwise it stays as far away as it is."""
    max_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.05
    """Greatest speed of the scope's tip."""


class ImageServoController:
    """A `TipController` of the scope's tip that closes the loop through the picture alone.

    In each new frame the target's marker is at (x, y) = ((u - cx) / fx, (v - cy) / fy) with depth Z. The tip's velocity is
    chosen so that by the interaction matrix of a pivoting scope both features and the depth decay at the gain's rate; until the
    next frame it is kept. The arm's kinematics give no more than the length of the inserted shaft: unlike `LookController`, it
    does not take the camera's motion since the capture into account. So a delay d costs stability: with frames a period T
    apart, the loop is x[k+1] = x[k] - K T x[k-d].
    """

    def __init__(self, rig: Rig, config: ImageServoConfig | None = None) -> None:
        """Take the camera's geometry."""
        self._config = config or ImageServoConfig()
        self._rig = rig
        self.reset()

    @classmethod
    def of(cls, rig: Rig, *, predictor: object = None, **fields: Any) -> "ImageServoController":
        """Make a controller from the fields of its configuration.

        Raises:
            InvalidValueError: If a predictor of the tissue's motion is given; it has no use for one.
        """
        if predictor is not None:
            raise InvalidValueError("predictor", predictor, "own with image-servo, whose `compensation` bridges delay")
        values: Mapping[str, Any] = fields
        return cls(rig, from_plain(ImageServoConfig, values))

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._newest_ns = -1
        self._last_ns: int | None = None
        self._rate = np.zeros(3)
        self._moved = np.zeros(3)
        self._past: deque[tuple[int, Array]] = deque()
        self._place: Array | None = None

    def command(self, state: ControlInput) -> Array:
        """Return the desired velocity (3,) of the scope's tip in m/s in the camera's frame.

        Raises:
            InvalidValueError: If the scope's trocar is missing.
        """
        if state.scope_trocar_in_camera is None:
            raise InvalidValueError("scope_trocar_in_camera", None, "where the scope's shaft passes the wall, (3,)")
        self._remember(state.now_ns)
        if state.depth is not None and state.depth.captured_ns > self._newest_ns:
            self._newest_ns = state.depth.captured_ns
            self._see(state, state.depth)
        if self._place is None:
            return np.zeros(3)
        point = self._place + self._moved if self._config.compensation == "smith" else self._place
        rate = self._config.gain_per_s * (np.array([0.0, 0.0, state.working_distance_m]) - point)
        if not self._config.hold_distance:
            rate[2] = 0.0
        lever = np.array([0.5 * self._rig.baseline_m, 0.0, 0.0])
        inserted = float(np.linalg.norm(state.scope_trocar_in_camera - lever))
        velocity = scope_tip_velocity(rate, point - lever, inserted)
        allowed = limited(velocity, self._config.max_speed_mps)
        self._rate = rate * (np.linalg.norm(allowed) / max(float(np.linalg.norm(velocity)), 1e-12))
        return allowed

    def _remember(self, now_ns: int) -> None:
        """Add what the last command should have moved the target by, and forget what no frame can be as old as."""
        if self._last_ns is not None:
            self._moved = self._moved + self._rate * ((now_ns - self._last_ns) * 1e-9)
        self._last_ns = now_ns
        self._past.append((now_ns, self._moved))
        while len(self._past) > 2 and self._past[1][0] < now_ns - _LONGEST_NS:
            self._past.popleft()

    def _see(self, state: ControlInput, depth: DepthFrame) -> None:
        """Take the target's place from a new frame that shows its marker."""
        pixel, camera = state.marker_pixel, self._rig.camera
        if pixel is None or not np.isfinite(pixel).all():
            return
        estimate = depth.estimate
        row = min(max(int(pixel[1]), 0), camera.height - 1)
        column = min(max(int(pixel[0]), 0), camera.width - 1)
        known = self._place[2] if self._place is not None else state.working_distance_m
        depth_m = float(estimate.depth_mm[row, column]) * 1e-3 if estimate.valid[row, column] else float(known)
        place = camera.unproject(pixel, depth_m)
        if self._config.compensation == "smith":
            told = self._config.told_delay_s
            captured_ns = depth.captured_ns if told is None else state.now_ns - round(told * 1e9)
            place = place - self._moved_until(captured_ns)
        self._place = place

    def _moved_until(self, time_ns: int) -> Array:
        """Return the model's motion at a time, (3,), between ticks in proportion."""
        times = np.array([time for time, _ in self._past], dtype=np.float64)
        moved = np.array([moved for _, moved in self._past])
        return np.array([np.interp(time_ns, times, moved[:, axis]) for axis in range(3)])


_LONGEST_NS = 6_000_000_000
"""Frames are not older; no stage of the loop takes longer than five seconds."""
