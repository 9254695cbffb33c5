"""The perception stage as a server with one worker, in simulated time."""

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from laploop.arrays import Array
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.perception.estimators.base import DepthEstimator, checked_estimate
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points
from laploop.perception.messages import DepthEstimate, DepthFrame, StripeFrame

_COVERED_MM = 3.0
"""A point so far behind what its pixel shows is not seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CapturedFrame:
    """A frame together with what only the simulator knows about it."""

    frame: StripeFrame
    truth: StripeCapture

    def visible_pixel(self, point_in_world: Array, world_from_camera: Array, camera: Intrinsics) -> Array | None:
        """Return where a point of the tissue, (3,), appears in the frame, (2,), or None where it is out of view or covered."""
        point = transform_points(invert_transform(world_from_camera), point_in_world)
        if point[2] <= 0.0:
            return None
        pixel = camera.project(point)
        column, row = int(np.floor(pixel[0])), int(np.floor(pixel[1]))
        if not (0 <= column < camera.width and 0 <= row < camera.height):
            return None
        # Deeper than what the pixel shows by more than the tissue's slope explains: something is in front of it.
        covered = self.truth.object_id[row, column] != ObjectId.TISSUE
        covered = covered or point[2] * 1e3 - float(self.truth.depth_mm[row, column]) > _COVERED_MM
        return None if covered else pixel


@dataclass(frozen=True, kw_only=True, eq=False)
class ServedFrame:
    """A finished depth frame and the capture that it was made from."""

    depth: DepthFrame
    captured: CapturedFrame


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    captured: CapturedFrame
    done_ns: int
    result: "Future[tuple[DepthEstimate, float]]"


class PerceptionServer:
    """Serves one frame at a time; a frame that arrives while it is busy waits, and a newer one takes its place.

    So throughput and latency are both real: with a service time above the camera period, frames are dropped. The estimate
    itself is computed on a thread of its own while physics goes on, and awaited when it is due; it depends on the
    image alone, so that wall-clock time never reaches the simulation.
    """

    def __init__(self, estimator: DepthEstimator, service_ns: Iterator[int]) -> None:
        """Serve with the estimator; `service_ns` yields the service time of each frame that is started."""
        self._estimator = estimator
        self._service_ns = service_ns
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="perception")
        self._job: _Job | None = None
        self._waiting: CapturedFrame | None = None
        self.dropped = 0
        """Frames that a newer one replaced while they waited."""
        self.last_compute_s: float | None = None
        """Wall-clock time that the estimator took for the frame delivered last."""

    def submit(self, captured: CapturedFrame) -> None:
        """Hand over a frame at its `available_ns`; frames come in the order of time."""
        if self._job is None:
            self._start(captured, captured.frame.available_ns)
            return
        if self._waiting is not None:
            self.dropped += 1
        self._waiting = captured

    def poll(self, now_ns: int) -> list[ServedFrame]:
        """Return the depth frames that were finished since the last call, oldest first."""
        finished: list[ServedFrame] = []
        while self._job is not None and self._job.done_ns <= now_ns:
            job = self._job
            estimate, self.last_compute_s = job.result.result()
            frame = job.captured.frame
            depth = DepthFrame(
                index=frame.index,
                estimate=estimate,
                captured_ns=frame.captured_ns,
                available_ns=job.done_ns,
                world_from_camera=frame.world_from_camera,
            )
            finished.append(ServedFrame(depth=depth, captured=job.captured))
            self._job = None
            if self._waiting is not None:
                waiting, self._waiting = self._waiting, None
                self._start(waiting, max(job.done_ns, waiting.frame.available_ns))
        return finished

    def close(self) -> None:
        """Wait for the worker and end its thread."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _start(self, captured: CapturedFrame, start_ns: int) -> None:
        result = self._executor.submit(self._timed_estimate, captured)
        self._job = _Job(captured=captured, done_ns=start_ns + next(self._service_ns), result=result)

    def _timed_estimate(self, captured: CapturedFrame) -> tuple[DepthEstimate, float]:
        if isinstance(self._estimator, OracleEstimator):
            self._estimator.see_truth(captured.truth.depth_mm)
        begin = time.perf_counter()
        image = captured.frame.image
        estimate = checked_estimate(self._estimator.estimate(image), image.shape[:2])
        return estimate, time.perf_counter() - begin
