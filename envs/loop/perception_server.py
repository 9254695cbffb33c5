"""The perception stage as a server with one or more workers, in simulated time."""

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from heapq import heappop, heappush
from typing import Any, NamedTuple

from laploop.arrays import Array
from laploop.envs.loop.background import BackgroundWorker, Pending
from laploop.envs.loop.captured_frame import CapturedFrame
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.loop.timing.config import TimingConfig, TimingSamples
from laploop.envs.loop.timing.latency import measured_ns
from laploop.envs.loop.timing.log import TimingLog
from laploop.envs.recording.recorder import DepthRecord
from laploop.envs.sensors.object_id import ObjectId
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
            captured_ns=self.captured.time_stamp_ns,
            available_ns=self.available_ns,
            world_from_camera=self.captured.world_from_camera,
        )

    def age_ns(self, now_ns: int) -> int:
        """Time since the capture, whatever the time stamp says."""
        return now_ns - self.captured_ns

    def record(self, now_ns: int) -> DepthRecord:
        """Return what a recorder receives of it."""
        truth = self.captured.truth
        return DepthRecord(
            now_ns=now_ns,
            depth=self.depth,
            stripes=truth.image,
            exact_depth_mm=truth.depth_mm,
            tissue=truth.object_id == ObjectId.TISSUE,
        )

    def changed(self, change: Callable[[DepthEstimate], DepthEstimate]) -> "ServedFrame":
        """Return the frame with a further change to its estimate."""
        return replace(self, changes=(*self.changes, change))

    def marker_pixel(self, camera: Intrinsics) -> Array | None:
        """Return where the target's marker was seen, (2,), or None."""
        return None if self.marker_hidden else self.captured.marker_pixel(camera)


class _Job(NamedTuple):
    """Ordered by time, then by frame."""

    done_ns: int
    frame: int
    captured: CapturedFrame
    estimate: Pending[DepthEstimate]


class _Estimate:
    """An estimate under way, and how long it took."""

    def __init__(self, estimator: DepthEstimator, seen: Pending[Any]) -> None:
        """Estimate from an image, or from the exact depth for the oracle."""
        self._estimator = estimator
        self.seen = seen
        self.seconds = 0.0

    def __call__(self) -> DepthEstimate:
        seen = self.seen.result()
        begin = time.perf_counter()
        if isinstance(self._estimator, OracleEstimator):
            estimate = self._estimator.estimate_of(seen.depth_mm)
        else:
            estimate = checked_estimate(self._estimator.estimate(seen.image), seen.image.shape[:2])
        self.seconds = time.perf_counter() - begin
        return estimate


class PerceptionServer:
    """Serves a frame a worker at a time; frames that arrive while all are busy wait as the queue has it.

    So throughput and latency are both real: with a service time above the camera period, frames are dropped. The estimate
    itself is computed on a thread of its own while physics goes on, if `ahead`, or else when somebody asks for it; it
    depends on the image alone. Wall-clock time reaches the simulation only where the service time is measured, and the loop
    then waits for every estimate.
    """

    def __init__(
        self,
        estimator: DepthEstimator,
        config: TimingConfig,
        samples: TimingSamples,
        log: TimingLog,
        timer: StageTimer,
        *,
        ahead: bool = True,
        after: BackgroundWorker | None = None,
    ) -> None:
        """Serve the frames of one episode with the estimator, which `after`, of an abandoned server, may still be using."""
        self._estimator = estimator
        self._config = config
        self._samples = samples
        self._log = log
        self._thread = BackgroundWorker("perception", timer, after=after)
        self._jobs: list[_Job | None] = [None] * config.workers
        self._waiting: deque[CapturedFrame] = deque()
        self._pipeline: list[_Job] = []
        self._newest_index = -1
        self.ahead = ahead
        """Whether estimates are begun before anybody asks for them."""

    @property
    def begins_images(self) -> bool:
        """Whether the images of frames are rendered, for their estimates, before anybody asks for these."""
        return self.ahead and not isinstance(self._estimator, OracleEstimator)

    def submit(self, captured: CapturedFrame) -> None:
        """Hand over a frame at its `available_ns`; frames come in the order of these times."""
        # Workers that were done before it came have taken what waited.
        self._finish(captured.available_ns - 1)
        captured.times.arrived_ns = captured.available_ns
        if captured.index < self._newest_index:
            self._log.out_of_order += 1
        self._newest_index = max(self._newest_index, captured.index)
        if None in self._jobs:
            self._start(captured, captured.available_ns, self._jobs.index(None))
        elif len(self._waiting) < self._config.capacity:
            self._waiting.append(captured)
        elif self._config.queue == "fifo":
            self._log.drop(captured.times, "refused")
        else:
            older, newer = sorted((self._waiting.popleft(), captured), key=lambda frame: frame.index)
            self._log.drop(older.times, "replaced")
            self._waiting.append(newer)

    def poll(self, now_ns: int) -> list[ServedFrame]:
        """Return the frames that have become available since the last call, in the order of that."""
        self._finish(now_ns)
        served: list[ServedFrame] = []
        while self._pipeline and self._pipeline[0].done_ns <= now_ns:
            job = heappop(self._pipeline)
            served.append(ServedFrame(captured=job.captured, available_ns=job.done_ns, estimate=job.estimate))
        return served

    def abandon(self) -> BackgroundWorker | None:
        """Begin nothing any more; return whoever may be using the estimator, without waiting for it."""
        unfinished = self._thread.unfinished()
        self._thread.abandon()
        return unfinished

    def settle(self) -> None:
        """Wait for what is under way, and go on."""
        self._thread.settle()

    def close(self) -> None:
        """Wait for what is under way and end the thread."""
        self._thread.close()

    def _finish(self, now_ns: int) -> None:
        """Take from the workers what they are done with, and give them what waits, in the order of time."""
        while done := [job for job in self._jobs if job is not None and job.done_ns <= now_ns]:
            job = min(done)
            done_ns, worker = job.done_ns, self._jobs.index(job)
            self._jobs[worker] = None
            job.captured.times.finished_ns = done_ns
            heappush(self._pipeline, job._replace(done_ns=done_ns + next(self._samples.pipeline)))
            if self._waiting:
                waiting = self._waiting.popleft()
                self._start(waiting, max(done_ns, waiting.available_ns), worker)

    def _start(self, captured: CapturedFrame, start_ns: int, worker: int) -> None:
        made, estimate = self._pending(captured)
        if self.ahead:
            # The image at once: the thread of estimates may still be busy with the frame before.
            made.seen.begin()
            estimate.begin()
        if self._samples.service is None:
            estimate.wait()
            service_ns = measured_ns(made.seconds)
        else:
            service_ns = next(self._samples.service)
        self._log.service_ns.append(service_ns)
        captured.times.started_ns = start_ns
        captured.times.worker = worker
        self._jobs[worker] = _Job(start_ns + service_ns, captured.index, captured, estimate)

    def _pending(self, captured: CapturedFrame) -> tuple[_Estimate, Pending[DepthEstimate]]:
        """Return the estimate that is to be made of a frame."""
        exact = isinstance(self._estimator, OracleEstimator)
        seen: Pending[Any] = captured.view.depth if exact else captured.view.whole
        made = _Estimate(self._estimator, seen)
        return made, self._thread.later(made, after=seen)
