"""What became of every frame and every command of an episode, and when."""

from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

FrameFate = Literal["lost", "replaced", "refused", "withheld", "overtaken"]
"""Why a frame never reached a consumer.

- `lost`: on its way from the camera.
- `replaced`: a newer one took its place in front of perception.
- `refused`: it found the queue full.
- `withheld`: by an injected fault.
- `overtaken`: it came from perception after a newer one.
"""


FRAME_STAGES = ("transfer", "queue", "service", "pipeline", "wait")
"""What makes the age of a frame at its first use: from the capture to perception, in front of it, in it, from it to the
consumers, and there until the next control tick."""


@dataclass(kw_only=True)
class FrameTimes:
    """Simulated times of a frame in nanoseconds; None for what has not happened."""

    index: int
    captured_ns: int
    """Middle of the exposure."""
    arrived_ns: int | None = None
    """At perception."""
    started_ns: int | None = None
    """By a worker."""
    finished_ns: int | None = None
    available_ns: int | None = None
    """To consumers."""
    first_used_ns: int | None = None
    """First control tick at which it was the newest that had become available."""
    worker: int | None = None
    """Number of the worker that served it, from 0 on."""
    dropped: FrameFate | None = None

    def durations_ms(self) -> dict[str, float]:
        """Return how long each stage had the frame, in milliseconds, as far as it came; keys are among `FRAME_STAGES`."""
        moments = (
            self.captured_ns,
            self.arrived_ns,
            self.started_ns,
            self.finished_ns,
            self.available_ns,
            self.first_used_ns,
        )
        return {
            stage: (end - begin) * 1e-6
            for stage, (begin, end) in zip(FRAME_STAGES, pairwise(moments), strict=True)
            if begin is not None and end is not None
        }


@dataclass(kw_only=True)
class CommandTimes:
    """Simulated times of a control tick's command in nanoseconds."""

    tick_ns: int
    """When its controllers began."""
    computed_ns: int
    """When they were done."""
    arrived_ns: int
    """At the arm."""
    effective_ns: int
    """Begin of the physics step from which on the arm follows it."""
    overtaken: bool = False
    """Whether a later tick's command had taken effect before, so that this one never did."""


@dataclass(kw_only=True)
class TimingLog:
    """The times of an episode."""

    frames: list[FrameTimes] = field(default_factory=list)
    """In the order of capture."""
    commands: list[CommandTimes] = field(default_factory=list)
    """In the order of control ticks."""
    service_ns: list[int] = field(default_factory=list)
    """Service times of perception, in the order in which frames were started."""
    compute_ns: list[int] = field(default_factory=list)
    """Computing times of the controllers, one a control tick."""
    dropped: Counter[FrameFate] = field(default_factory=Counter)
    """Frames by what became of them."""
    out_of_order: int = 0
    """Frames that arrived at perception after a newer one."""
    newest_used: FrameTimes | None = None
    """The newest frame that a control tick has known."""
    overtaken_commands: int = 0
    """Commands that arrived at the arm after a newer one."""

    def capture(self, times: FrameTimes) -> None:
        """Take up a new frame."""
        self.frames.append(times)

    def drop(self, times: FrameTimes, fate: FrameFate) -> None:
        """Note that a frame reaches no consumer."""
        times.dropped = fate
        self.dropped[fate] += 1

    def deliver(self, times: FrameTimes, available_ns: int) -> None:
        """Note that a frame becomes available to consumers, though a fault may have withheld it before."""
        times.available_ns = available_ns
        if times.dropped is not None:
            self.dropped[times.dropped] -= 1
            times.dropped = None

    def use(self, times: FrameTimes, now_ns: int) -> None:
        """Note that a control tick knows a frame, and none that is newer."""
        if times is not self.newest_used:
            self.newest_used = times
            times.first_used_ns = now_ns

    def newest_ms(self) -> dict[str, float]:
        """Return how long each stage had the newest frame that a control tick has known; empty before there is one."""
        return {} if self.newest_used is None else self.newest_used.durations_ms()

    @property
    def dropped_frames(self) -> int:
        """Frames that reached no consumer, those apart that a fault withheld."""
        return sum(count for fate, count in self.dropped.items() if fate != "withheld")
