"""The way of frames from the camera to perception."""

from heapq import heappop, heappush
from typing import TYPE_CHECKING

from laploop.envs.loop.timing.config import TimingConfig, TimingSamples
from laploop.envs.loop.timing.log import TimingLog

if TYPE_CHECKING:
    from laploop.envs.loop.captured_frame import CapturedFrame


class FrameTransfer:
    """Carries frames; they may be lost, and arrive in another order than they were captured in."""

    def __init__(self, config: TimingConfig, samples: TimingSamples, log: TimingLog) -> None:
        """Carry the frames of one episode."""
        self._departure_ns = config.departure_ns
        self._samples = samples
        self._log = log
        self._under_way: list[tuple[int, int, CapturedFrame]] = []
        self.newest: CapturedFrame | None = None
        """Of those that have arrived, the one that was captured last."""

    def arrival_ns(self, captured_ns: int) -> int:
        """Return when the frame that was captured just now will arrive; to be asked once a frame."""
        return captured_ns + self._departure_ns + next(self._samples.transfer)

    def send(self, frame: "CapturedFrame") -> None:
        """Send a frame, which is to arrive at its `available_ns`."""
        lost = next(self._samples.dropped)
        # The target is chosen in the first frame, so that it is never lost.
        if lost and frame.index > 0:
            self._log.drop(frame.times, "lost")
        else:
            heappush(self._under_way, (frame.available_ns, frame.index, frame))

    def arrived(self, now_ns: int) -> "list[CapturedFrame]":
        """Return the frames that have arrived since the last call, in the order of arrival."""
        frames = []
        while self._under_way and self._under_way[0][0] <= now_ns:
            frames.append(heappop(self._under_way)[-1])
            if self.newest is None or frames[-1].index > self.newest.index:
                self.newest = frames[-1]
        return frames
