"""What an episode records, what a recorder receives, and the simplest recorders.

Nobody writes to a record's arrays once it is made: a recorder may keep them without a copy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from laploop.envs.loop.timing.log import TimingLog
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthFrame, StripeFrame

if TYPE_CHECKING:
    from laploop.envs.theatre.theatre import Theatre

ARM_NAMES = ("camera", "tool")
"""Keys of `TickRecord.rcm_error_mm` and `TickRecord.port_force_n`."""

STAGES = ("physics", "capture", "render", "perception", "wait", "control", "record")
"""Keys that `TickRecord.stage_ms` may have: wall time spent in a stage since the previous tick.

`render` and `perception` run in the background; `wait` is how long the main thread waited for them, and `capture` how long it
took to copy what they need.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameRecord:
    """A frame that the camera has just captured; one each camera period."""

    now_ns: int
    frame: StripeFrame
    exact_depth_mm: NDArray[np.float32]
    """(height, width), true z-depth at the capture; NaN where the ray hits nothing."""
    object_id: NDArray[np.uint8]
    """(height, width), what each pixel sees, as the stripe camera numbers it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthRecord:
    """A depth frame that has just become available to its consumers."""

    now_ns: int
    depth: DepthFrame
    stripes: NDArray[np.uint8]
    """(height, width), the image that `depth` was made from."""
    exact_depth_mm: NDArray[np.float32]
    """(height, width), the truth when that image was captured; NaN where the ray hits nothing."""
    tissue: NDArray[np.bool_]
    """(height, width), where that image shows tissue."""

    def error_mm(self) -> NDArray[np.float32]:
        """Estimated minus true depth, (height, width); NaN where the estimate is not valid or off the tissue."""
        seen = self.depth.estimate.valid & self.tissue
        return np.where(seen, self.depth.estimate.depth_mm - self.exact_depth_mm, np.float32(np.nan))


@dataclass(frozen=True, kw_only=True, eq=False)
class TickRecord:
    """The state of the task at a control tick."""

    now_ns: int
    target_error_mm: float
    """Distance from the tip to where it should be, touching the true target point."""
    target_in_world: NDArray[np.float64]
    """(3,), metres: where the true target point on the tissue is now."""
    rcm_error_mm: Mapping[str, float]
    """Distance of each trocar from its shaft's axis by the simulator's state; keys are `ARM_NAMES`."""
    contact_force_n: float
    depth_age_ms: float | None
    """Time since the capture of the newest frame that has arrived; None before the first."""
    stage_ms: Mapping[str, float]
    """Wall time of the stages that ran since the previous tick; a stage that did not run is absent."""
    port_force_n: Mapping[str, float] = field(default_factory=dict)
    """Lateral force of the wall around each trocar on its shaft; keys are `ARM_NAMES`, empty where there are no trocars."""
    frame_ms: Mapping[str, float] = field(default_factory=dict)
    """Simulated time that each stage had the newest frame that a control tick knew; keys are `FRAME_STAGES`."""
    command_mps: NDArray[np.float64] | None = None
    """(3,), commanded velocity of the moved tip during the period that has just ended, along the camera's axes."""
    tip_velocity_mps: NDArray[np.float64] | None = None
    """(3,), velocity of the moved tip at its end, along the camera's axes, by the simulator's state."""
    goal_in_world: NDArray[np.float64] | None = None
    """(3,), metres: where the tool's tip touches the true target; None where the tool has no goal."""
    off_goal_mm: Mapping[str, float] = field(default_factory=dict)
    """Tip from goal: `along` the target's normal, outwards positive, and `across` it; empty without a goal."""
    joint_position_share: NDArray[np.float64] | None = None
    """(6,), joint angles of the moved arm over their limits, worst of the period; 1 is at the limit."""
    joint_speed_share: NDArray[np.float64] | None = None
    """(6,), the same of the joint speeds."""
    status: str = ""
    """Of the inverse kinematics."""
    status_reason: str = ""
    """What keeps the arm from following; empty while it follows."""
    faults: str = ""
    """Why the command was not followed, and the injected faults that are active; empty without any."""
    reward_terms: Mapping[str, float] = field(default_factory=dict)
    """Weighted terms of the reward."""
    dropped_frames: int = 0
    """Frames so far that reached no consumer."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PredictionRecord:
    """Where a controller takes its target to be at a control tick, and where it is."""

    now_ns: int
    predicted_in_camera: NDArray[np.float64]
    """(3,), metres, in the frame that the controller works in."""
    true_in_camera: NDArray[np.float64]
    """(3,), metres, in the true camera's frame."""
    predicted_in_world: NDArray[np.float64]
    """(3,), metres, by the controller's kinematics."""


class Recorder:
    """Receives an episode: `begin`, then records in the order of time, then `timing` and `close`.

    A subclass defines the methods it is interested in; the others do nothing, and what they would be given is not computed.
    """

    @property
    def takes_ticks(self) -> bool:
        """Whether it records control ticks."""
        return type(self).tick is not Recorder.tick

    @property
    def takes_frames(self) -> bool:
        """Whether it records captured frames."""
        return type(self).frame is not Recorder.frame

    @property
    def takes_depth(self) -> bool:
        """Whether it records depth frames."""
        return type(self).depth is not Recorder.depth

    def begin(self, theatre: "Theatre", rig: Rig) -> None:
        """Learn the scene. The theatre is at time 0 with fresh kinematics; it may be read at every later record."""

    def tick(self, record: TickRecord) -> None:
        """Take a control tick."""

    def prediction(self, record: PredictionRecord) -> None:
        """Take a scripted controller's idea of its target, before the tick's command is carried out."""

    def frame(self, record: FrameRecord) -> None:
        """Take a captured frame; the theatre's kinematics are those of the capture."""

    def depth(self, record: DepthRecord) -> None:
        """Take a depth frame that has just arrived."""

    def timing(self, log: TimingLog) -> None:
        """Take the times of all frames and commands, at the end of an episode that was not interrupted."""

    def close(self) -> None:
        """Finish, however the episode ended; harmless when called again."""


class NullRecorder(Recorder):
    """Records nothing."""


class CompositeRecorder(Recorder):
    """Hands everything to several recorders, in their order."""

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = tuple(recorders)

    @property
    def takes_ticks(self) -> bool:
        """Whether any of them records control ticks."""
        return any(recorder.takes_ticks for recorder in self._recorders)

    @property
    def takes_frames(self) -> bool:
        """Whether any of them records captured frames."""
        return any(recorder.takes_frames for recorder in self._recorders)

    @property
    def takes_depth(self) -> bool:
        """Whether any of them records depth frames."""
        return any(recorder.takes_depth for recorder in self._recorders)

    def begin(self, theatre: "Theatre", rig: Rig) -> None:
        """Begin all of them."""
        for recorder in self._recorders:
            recorder.begin(theatre, rig)

    def tick(self, record: TickRecord) -> None:
        """Pass a control tick on."""
        for recorder in self._recorders:
            recorder.tick(record)

    def prediction(self, record: PredictionRecord) -> None:
        """Pass a controller's idea of its target on."""
        for recorder in self._recorders:
            recorder.prediction(record)

    def frame(self, record: FrameRecord) -> None:
        """Pass a frame on."""
        for recorder in self._recorders:
            recorder.frame(record)

    def depth(self, record: DepthRecord) -> None:
        """Pass a depth frame on."""
        for recorder in self._recorders:
            recorder.depth(record)

    def timing(self, log: TimingLog) -> None:
        """Pass the times on."""
        for recorder in self._recorders:
            recorder.timing(log)

    def close(self) -> None:
        """Close all of them."""
        for recorder in self._recorders:
            recorder.close()
