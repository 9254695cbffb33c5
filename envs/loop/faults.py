"""Failures of sensors and controllers at chosen times, for tests and for controllers that must survive them."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.envs.loop.proprioception import ProprioceptiveReading
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics
from laploop.perception.messages import DepthEstimate

if TYPE_CHECKING:
    from laploop.envs.loop.perception_server import ServedFrame

FaultKind = Literal[
    "perception-stops",
    "depth-jump",
    "depth-invalid",
    "late-frame",
    "target-hidden",
    "tissue-unreachable",
    "force-saturates",
    "controller-nan",
]
"""Names of the faults, in the order in which they are listed to users."""

OUT_OF_REACH = "target out of reach: the shaft goes no deeper into its trocar"
"""Why the tip is held back while the tissue cannot be reached."""

_BRAKING_MPS2 = 0.5
"""Deceleration of a shaft at the end of its way; the arm's controller can do twice that."""


@configuration
class Fault:
    """One fault and when it lasts, in simulated time.

    - `perception-stops`: no depth frame captured in this time arrives.
    - `depth-jump`: the first depth frame captured in this time is too deep by `jump_m`.
    - `depth-invalid`: no pixel of the depth frames captured in this time is valid.
    - `late-frame`: the first frame captured in this time arrives at its end, after newer ones.
    - `target-hidden`: nothing is valid within `radius_px` of the target, and its marker is not seen.
    - `tissue-unreachable`: the moved shaft goes at most `room_m` deeper into its trocar than it was at the begin of this time,
      as at a stop, so that what lies deeper is out of reach.
    - `force-saturates`: the force sensor reads `full_scale_n`.
    - `controller-nan`: the action of every control tick is replaced by one that is not a number.
    """

    kind: FaultKind
    start_s: Annotated[float, Field(ge=0.0, le=3600.0)]
    """Begin, in simulated time."""
    end_s: Annotated[float, Field(gt=0.0, le=3600.0)]
    """End, after the begin."""
    jump_m: Annotated[float, Field(ge=-0.1, le=0.1)] = 0.02
    """How much too deep a jump puts the surface."""
    radius_px: Annotated[float, Field(ge=1.0, le=1e4)] = 60.0
    """Around the target, how much of the image is hidden with it."""
    room_m: Annotated[float, Field(ge=0.002, le=0.3)] = 0.003
    """How much deeper the shaft goes before it meets its stop."""
    full_scale_n: Annotated[float, Field(ge=0.01, le=1e3)] = 10.0
    """What a saturated force sensor reads."""

    def __post_init__(self) -> None:
        if not self.start_s < self.end_s:
            raise InvalidValueError("end_s", self.end_s, f"above start_s ({self.start_s:g})")

    def active(self, now_ns: int) -> bool:
        """Return whether the fault is active at a time."""
        return self.start_s <= now_ns * 1e-9 < self.end_s


class FaultInjector:
    """Puts the faults of a schedule between the sensors and their consumers, for one episode."""

    def __init__(self, faults: tuple[Fault, ...]) -> None:
        self._faults = faults
        self._jumped: set[Fault] = set()
        self._held: dict[Fault, ServedFrame] = {}
        self._stops: dict[Fault, float] = {}

    def active(self, now_ns: int) -> tuple[str, ...]:
        """Return the kinds of the faults that are active at a time."""
        return tuple(fault.kind for fault in self._faults if fault.active(now_ns))

    def depth_frames(self, frames: "list[ServedFrame]", camera: Intrinsics, now_ns: int) -> "list[ServedFrame]":
        """Return the depth frames that arrive now, in their order, given those that would without faults.

        Args:
            frames: What the perception stage delivers.
            camera: What took the frames.
            now_ns: Simulated time.
        """
        arriving = [changed for frame in frames if (changed := self._changed(frame, camera)) is not None]
        for fault in [fault for fault in self._held if now_ns * 1e-9 >= fault.end_s]:
            late = self._held.pop(fault)
            arriving.append(replace(late, available_ns=now_ns))
        return arriving

    def reading(self, reading: ProprioceptiveReading, now_ns: int) -> ProprioceptiveReading:
        """Return what the tool's own channels deliver now; a saturated sensor reads its full scale (upwards by default)."""
        for fault in self._faults:
            if fault.kind == "force-saturates" and fault.active(now_ns):
                force = reading.contact_force_in_world
                size = float(np.linalg.norm(force))
                direction = force / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
                reading = replace(reading, contact_force_in_world=fault.full_scale_n * direction)
        return reading

    def action(self, action: Array, now_ns: int) -> Array:
        """Return the action of a control tick."""
        if "controller-nan" in self.active(now_ns):
            return np.full_like(action, np.nan)
        return action

    def velocity(self, velocity: Array, axis: Array, insertion_m: float, period_s: float, now_ns: int) -> tuple[Array, str]:
        """Return the possible velocity of the tip, (3,) m/s, and what holds it back; empty if nothing does.

        Args:
            velocity: The commanded one, (3,).
            axis: (3,), unit, along the shaft from the trocar to the tip, in the same frame.
            insertion_m: From the trocar to the tip.
            period_s: For how long the velocity counts.
            now_ns: Simulated time.
        """
        reason = ""
        for fault in self._faults:
            if fault.kind != "tissue-unreachable" or not fault.active(now_ns):
                continue
            left = max(self._stops.setdefault(fault, insertion_m + fault.room_m) - insertion_m, 0.0)
            fastest = min(math.sqrt(2.0 * _BRAKING_MPS2 * left), 0.5 * left / period_s)
            deeper = float(velocity @ axis)
            if deeper > fastest:
                velocity = velocity - (deeper - fastest) * axis
                reason = OUT_OF_REACH
        return velocity, reason

    def _changed(self, frame: "ServedFrame", camera: Intrinsics) -> "ServedFrame | None":
        for fault in self._faults:
            if not fault.active(frame.captured_ns):
                continue
            if fault.kind == "perception-stops":
                return None
            if fault.kind == "depth-jump" and fault not in self._jumped:
                self._jumped.add(fault)
                frame = frame.changed(partial(_shifted, by_mm=np.float32(fault.jump_m * 1e3)))
            if fault.kind == "depth-invalid":
                frame = frame.changed(_invalid)
            if fault.kind == "target-hidden":
                seen = frame.captured.marker_pixel
                frame = frame.changed(partial(_hidden, seen=partial(seen, camera), radius_px=fault.radius_px))
                frame = replace(frame, marker_hidden=True)
            if fault.kind == "late-frame" and fault not in self._jumped:
                self._jumped.add(fault)
                self._held[fault] = frame
                return None
        return frame


def _shifted(estimate: DepthEstimate, by_mm: np.float32) -> DepthEstimate:
    return DepthEstimate(depth_mm=estimate.depth_mm + by_mm, valid=estimate.valid)


def _invalid(estimate: DepthEstimate) -> DepthEstimate:
    return DepthEstimate(depth_mm=estimate.depth_mm, valid=np.zeros_like(estimate.valid))


def _hidden(estimate: DepthEstimate, seen: Callable[[], Array | None], radius_px: float) -> DepthEstimate:
    """Take away what is within a radius of the marker, where that is seen."""
    if (pixel := seen()) is None:
        return estimate
    rows, columns = np.indices(estimate.valid.shape)
    hidden = np.hypot(columns + 0.5 - pixel[0], rows + 0.5 - pixel[1]) < radius_px
    return DepthEstimate(depth_mm=estimate.depth_mm, valid=estimate.valid & ~hidden)
