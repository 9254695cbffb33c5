import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.loop.captured_frame import CapturedFrame
from laploop.envs.loop.perception_server import PerceptionServer
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.loop.timing.config import TimingConfig, TimingSamples
from laploop.envs.loop.timing.latency import ConstantLatency, MeasuredLatency, TraceLatency
from laploop.envs.loop.timing.log import TimingLog
from laploop.envs.sensors.stripe_capture import DepthView
from laploop.errors import SimulationError
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate

MS = 1_000_000
RIG = Rig.from_optics(ScopeOptics(width=16, height=16))


class Mean:
    """Says of every pixel that it is one millimetre deeper than the image is bright."""

    def estimate(self, image):
        return DepthEstimate(depth_mm=np.full(image.shape, 1.0 + image.mean(), np.float32), valid=np.ones(image.shape, bool))


class Held(Mean):
    """Waits for an event before it does."""

    def __init__(self, release):
        self.release = release

    def estimate(self, image):
        self.release.wait(5.0)
        return super().estimate(image)


class Rendered:
    """A view that is there at once."""

    def __init__(self, value):
        self.value = value
        self.asked = 0
        self.begun = False

    def begin(self):
        self.begun = True

    def result(self):
        self.asked += 1
        return self.value

    wait = result


def captured(index, captured_ns, *, arrives_after_ns=0, **more):
    shape = (16, 16)
    depth = DepthView(depth_mm=np.full(shape, 100.0 + index, np.float32), object_id=np.ones(shape, np.uint8))
    view = SimpleNamespace(whole=Rendered(SimpleNamespace(image=np.full(shape, index, np.uint8))), depth=Rendered(depth))
    return CapturedFrame(
        index=index,
        captured_ns=captured_ns,
        available_ns=captured_ns + arrives_after_ns,
        world_from_camera=np.eye(4),
        true_pose=np.eye(4),
        view=view,
        **more,
    )


@pytest.fixture
def serve():
    servers = []

    def make(estimator, service, *, ahead=True, **timing):
        config = TimingConfig(service=service, **timing)
        samples = TimingSamples.draw(config, np.random.default_rng(0), np.random.default_rng(1))
        log = TimingLog()
        servers.append(PerceptionServer(estimator, config, samples, log, StageTimer(), ahead=ahead))
        servers[-1].log = log
        return servers[-1]

    yield make
    for server in servers:
        server.close()


def test_a_frame_is_seen_from_its_service_time_on_and_not_before(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=40.0))
    server.submit(captured(3, 0, arrives_after_ns=2 * MS))
    assert server.poll(42 * MS - 1) == []
    (one,) = server.poll(42 * MS)
    assert (one.depth.index, one.depth.captured_ns, one.depth.available_ns) == (3, 0, 42 * MS)
    assert one.depth.age_ns(50 * MS) == 50 * MS
    assert one.depth.estimate.depth_mm[0, 0] == 4.0


def test_an_overtaken_frame_is_dropped(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=100.0))
    delivered = []
    for index in range(6):
        delivered += server.poll(index * 40 * MS)
        server.submit(captured(index, index * 40 * MS))
    delivered += server.poll(300 * MS)
    # Frame 0 keeps the worker until 100 ms; 1 is overtaken by 2, which keeps it until 200 ms; by then 4 has
    # taken the place of 3, and 5 comes as the worker takes 4.
    assert [one.depth.index for one in delivered] == [0, 2, 4]
    assert server.log.dropped == {"replaced": 2}


def test_a_waiting_frame_starts_when_the_worker_is_free(serve):
    server = serve(Mean(), TraceLatency(latencies_ms=(50.0, 10.0)))
    server.submit(captured(0, 0))
    server.submit(captured(1, 40 * MS))
    first, second = server.poll(60 * MS)
    assert (first.depth.available_ns, second.depth.available_ns) == (50 * MS, 60 * MS)


def test_the_oracle_sees_the_truth_of_the_frame_it_serves(serve):
    server = serve(OracleEstimator(RIG), ConstantLatency(latency_ms=50.0))
    server.submit(captured(0, 0))
    server.submit(captured(1, 40 * MS))
    assert [float(one.depth.estimate.depth_mm[0, 0]) for one in server.poll(200 * MS)] == [100.0, 101.0]


def test_simulated_arrival_does_not_depend_on_how_long_the_estimate_really_takes(serve):
    release = threading.Event()
    server = serve(Held(release), ConstantLatency(latency_ms=1.0))
    server.submit(captured(0, 0))
    threading.Timer(0.05, release.set).start()
    (one,) = server.poll(MS)
    assert one.depth.available_ns == MS


def test_an_image_is_rendered_while_the_estimate_before_it_is_still_under_way(serve):
    release = threading.Event()
    server = serve(Held(release), ConstantLatency(latency_ms=1.0))
    first, second = captured(0, 0), captured(1, 40 * MS)
    server.submit(first)
    server.submit(second)
    assert second.view.whole.begun
    release.set()


def test_an_error_in_the_estimator_reaches_the_caller(serve):
    class Broken:
        def estimate(self, image):
            raise ValueError("no such image")

    server = serve(Broken(), ConstantLatency(latency_ms=0.0))
    server.submit(captured(0, 0))
    (one,) = server.poll(0)
    with pytest.raises(ValueError, match="no such image"):
        _ = one.depth


@pytest.mark.parametrize("ahead", [True, False])
def test_an_estimate_is_made_ahead_only_where_it_will_be_asked_for(serve, ahead):
    made = threading.Event()

    class Telling(Mean):
        def estimate(self, image):
            made.set()
            return super().estimate(image)

    server = serve(Telling(), ConstantLatency(latency_ms=1.0), ahead=ahead)
    server.submit(captured(2, 0))
    (one,) = server.poll(MS)
    # Seconds: as long as a slow machine may take, or long enough to notice.
    assert made.wait(5.0 if ahead else 0.05) == ahead
    assert one.captured_ns == 0
    assert one.depth.estimate.depth_mm[0, 0] == 3.0
    assert made.is_set()


def test_exact_depth_needs_no_image(serve):
    server = serve(OracleEstimator(RIG), ConstantLatency(latency_ms=1.0))
    frame = captured(0, 0)
    server.submit(frame)
    (one,) = server.poll(MS)
    assert one.depth.estimate.valid.all()
    assert frame.view.whole.asked == 0


def test_what_was_not_computed_in_its_episode_cannot_be_computed_later(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=1.0), ahead=False)
    server.submit(captured(0, 0))
    (one,) = server.poll(MS)
    server.close()
    with pytest.raises(SimulationError, match="the episode ended before"):
        _ = one.depth


@pytest.mark.parametrize(
    ("queue", "capacity", "workers", "served", "dropped"),
    [
        # A frame every 40 ms, 100 ms of service each; (frame, worker, start, available) in ms.
        # One worker: at 100 frame 2 has taken the place of 1. What arrives in the same instant goes first: at 200 frame 5 has
        # taken the place of 4, which had taken that of 3.
        ("newest-wins", 1, 1, [(0, 0, 0, 100), (2, 0, 100, 200), (5, 0, 200, 300)], {"replaced": [1, 3, 4]}),
        # Places for two: 1 and 2 wait until 1 starts at 100, then 2 and 3, so that 4 and, at 200, 5 find them taken.
        ("fifo", 2, 1, [(0, 0, 0, 100), (1, 0, 100, 200), (2, 0, 200, 300), (3, 0, 300, 400)], {"refused": [4, 5]}),
        # Two workers: free at 100 and 140, then at 200 and 240.
        (
            "newest-wins",
            1,
            2,
            [(0, 0, 0, 100), (1, 1, 40, 140), (2, 0, 100, 200), (3, 1, 140, 240), (5, 0, 200, 300)],
            {"replaced": [4]},
        ),
        # 4 waits from 160, 5 from 200, when the arrival goes first and finds a place.
        (
            "fifo",
            2,
            2,
            [(0, 0, 0, 100), (1, 1, 40, 140), (2, 0, 100, 200), (3, 1, 140, 240), (4, 0, 200, 300), (5, 1, 240, 340)],
            {},
        ),
    ],
)
def test_queues_and_workers_do_what_was_computed_by_hand(serve, queue, capacity, workers, served, dropped):
    server = serve(Mean(), ConstantLatency(latency_ms=100.0), queue=queue, capacity=capacity, workers=workers)
    frames = [captured(index, index * 40 * MS) for index in range(6)]
    for frame in frames:
        server.submit(frame)
    found = server.poll(1000 * MS)
    times = [one.captured.times for one in found]
    assert [(one.index, one.worker, one.started_ns // MS, one.finished_ns // MS) for one in times] == served
    assert [one.available_ns // MS for one in found] == [finished for *_, finished in served]
    assert [one.age_ns(one.available_ns) // MS for one in found] == [end - 40 * index for index, _, _, end in served]
    fates = {fate: [frame.index for frame in frames if frame.times.dropped == fate] for fate in server.log.dropped}
    assert fates == dropped


def test_frames_overtake_each_other_at_several_workers_and_in_the_pipeline(serve):
    server = serve(Mean(), TraceLatency(latencies_ms=(90.0, 10.0)), workers=2)
    server.submit(captured(0, 0))
    server.submit(captured(1, 40 * MS))
    assert [(one.captured.index, one.available_ns // MS) for one in server.poll(200 * MS)] == [(1, 50), (0, 90)]
    server = serve(Mean(), ConstantLatency(latency_ms=10.0), pipeline=TraceLatency(latencies_ms=(90.0, 10.0)))
    server.submit(captured(0, 0))
    server.submit(captured(1, 40 * MS))
    # The pipeline keeps nobody busy: both frames are served at once.
    assert [(one.captured.index, one.available_ns // MS) for one in server.poll(200 * MS)] == [(1, 60), (0, 100)]


def test_frames_that_arrive_out_of_order_are_counted_and_the_newer_one_waits(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=100.0))
    server.submit(captured(0, 0))
    server.submit(captured(2, 20 * MS, arrives_after_ns=0))
    server.submit(captured(1, 10 * MS, arrives_after_ns=20 * MS))
    assert server.log.out_of_order == 1
    assert [one.captured.index for one in server.poll(500 * MS)] == [0, 2]
    assert server.log.dropped == {"replaced": 1}


def test_a_worker_that_was_done_before_a_frame_came_has_taken_the_one_that_waited(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=59.0))
    for index in range(3):
        server.submit(captured(index, index * 30 * MS))
    # Nobody looked between 59 and 60 ms.
    assert [one.captured.index for one in server.poll(500 * MS)] == [0, 1, 2]


def test_a_measured_service_takes_as_long_as_the_estimate_did(serve):
    class Slow(Mean):
        def estimate(self, image):
            time.sleep(0.02)
            return super().estimate(image)

    server = serve(Slow(), MeasuredLatency(), ahead=False)
    server.submit(captured(0, 0))
    (service_ns,) = server.log.service_ns
    # Seconds: a sleep is never shorter, and on a busy machine longer.
    assert 20 * MS <= service_ns < 2000 * MS
    assert server.poll(service_ns - 1) == []
    (one,) = server.poll(service_ns)
    assert one.available_ns == service_ns


def test_consumers_are_given_a_time_stamp_that_is_off_and_never_from_the_future(serve):
    server = serve(Mean(), ConstantLatency(latency_ms=10.0))
    for offset_ms, expected_ms in ((-15, 25), (3, 43), (100, 45)):
        frame = captured(1, 40 * MS, arrives_after_ns=5 * MS, time_stamp_offset_ns=offset_ms * MS)
        server.submit(frame)
        (one,) = server.poll(60 * MS)
        assert (one.captured_ns, one.depth.captured_ns, frame.time_stamp_ns) == (40 * MS, expected_ms * MS, expected_ms * MS)
        assert one.age_ns(60 * MS) == 20 * MS
        assert one.depth.age_ns(60 * MS) == (60 - expected_ms) * MS
