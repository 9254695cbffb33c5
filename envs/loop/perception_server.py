"""The perception stage as a server with one worker, in simulated time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.loop.background import BackgroundWorker, Pending
from laploop.envs.loop.captured_frame import CapturedFrame
from laploop.envs.loop.stage_timer import StageTimer
from laploop.perception.estimators.base import DepthEstimator, checked_estimate
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.geometry import Intrinsics
from laploop.perception.messages import DepthEstimate, DepthFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class ServedFrame:
    """A frame that perception is done with in simulated time; its depth map is awaited, or computed, when asked for."""

    captured: CapturedFrame
    available_ns: int
    """Simulated time from which consumers see it."""
    estimate: Pending[DepthEstimate]
    changes: tuple[Callable[[DepthEstimate], DepthEstimate], ...] = ()
    """What faults do to the estimate, in order."""
    marker_hidden: bool = False

    @property
    def captured_ns(self) -> int:
        """Simulated time of the capture."""
        return self.captured.captured_ns

    @cached_property
    def depth(self) -> DepthFrame:
        """The depth map as its consumers get it."""
        estimate = self.estimate.wait()
        for change in self.changes:
            estimate = change(estimate)
        return DepthFrame(
            index=self.captured.index,
            estimate=estimate,
            captured_ns=self.captured_ns,
            available_ns=self.available_ns,
            world_from_camera=self.captured.world_from_camera,
        )

    def age_ns(self, now_ns: int) -> int:
        """Time since capture."""
        return now_ns - self.captured_ns

    def changed(self, change: Callable[[DepthEstimate], DepthEstimate]) -> "ServedFrame":
        """Return the frame with a further change to its estimate."""
        return replace(self, changes=(*self.changes, change))

    def marker_pixel(self, camera: Intrinsics) -> Array | None:
        """Return where the target's marker was seen, (2,), or None."""
        return None if self.marker_hidden else self.captured.marker_pixel(camera)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    captured: CapturedFrame
    done_ns: int
    estimate: Pending[DepthEstimate]


class PerceptionServer:
    """Serves one frame at a time; a frame that arrives while it is busy waits, and a newer one takes its place.

    So throughput and latency are both real: with a service time above the camera period, frames are dropped. The estimate
    itself is computed on a thread of its own while physics goes on, if `ahead`, or else when somebody asks for it; it
    depends on the image alone, so that wall-clock time never reaches the simulation.
    """

    def __init__(self, estimator: DepthEstimator, service_ns: Iterator[int], timer: StageTimer, *, ahead: bool = True) -> None:
        """Serve with the estimator; `service_ns` yields the service time of each frame that is started."""
        self._estimator = estimator
        self._service_ns = service_ns
        self._worker = BackgroundWorker("perception", timer)
        self._job: _Job | None = None
        self._waiting: CapturedFrame | None = None
        self.ahead = ahead
        """Whether estimates are begun before anybody asks for them."""
        self.dropped = 0
        """Frames that a newer one replaced while they waited."""

    def submit(self, captured: CapturedFrame) -> None:
        """Hand over a frame at its `available_ns`; frames come in the order of time."""
        if self._job is None:
            self._start(captured, captured.available_ns)
            return
        if self._waiting is not None:
            self.dropped += 1
        self._waiting = captured

    def poll(self, now_ns: int) -> list[ServedFrame]:
        """Return the frames that were finished since the last call, oldest first."""
        finished: list[ServedFrame] = []
        while self._job is not None and self._job.done_ns <= now_ns:
            job = self._job
            finished.append(ServedFrame(captured=job.captured, available_ns=job.done_ns, estimate=job.estimate))
            self._job = None
            if self._waiting is not None:
                waiting, self._waiting = self._waiting, None
                self._start(waiting, max(job.done_ns, waiting.available_ns))
        return finished

    def abandon(self) -> None:
        """Begin nothing any more; does not wait for what is under way."""
        self._worker.abandon()

    def close(self) -> None:
        """Wait for the worker and end its thread."""
        self._worker.close()

    def _start(self, captured: CapturedFrame, start_ns: int) -> None:
        estimate = self._pending(captured)
        if self.ahead:
            estimate.begin()
        self._job = _Job(captured=captured, done_ns=start_ns + next(self._service_ns), estimate=estimate)

    def _pending(self, captured: CapturedFrame) -> Pending[DepthEstimate]:
        """Return the estimate that is to be made of a frame."""
        estimator = self._estimator
        if isinstance(estimator, OracleEstimator):
            depth = captured.view.depth
            return self._worker.later(lambda: estimator.estimate_of(depth.result().depth_mm), after=depth)
        whole = captured.view.whole
        return self._worker.later(lambda: self._estimate(whole.result().image), after=whole)

    def _estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        return checked_estimate(self._estimator.estimate(image), image.shape[:2])
