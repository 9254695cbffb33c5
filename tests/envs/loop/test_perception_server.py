import threading
from types import SimpleNamespace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.loop.captured_frame import CapturedFrame
from laploop.envs.loop.latency import ConstantLatency, TraceLatency
from laploop.envs.loop.perception_server import PerceptionServer
from laploop.envs.loop.stage_timer import StageTimer
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


class Rendered:
    """A view that is there at once."""

    def __init__(self, value):
        self.value = value
        self.asked = 0

    def result(self):
        self.asked += 1
        return self.value

    wait = result


def captured(index, captured_ns, *, arrives_after_ns=0):
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
    )


@pytest.fixture
def serve():
    servers = []

    def make(estimator, latency, **options):
        samples = latency.samples_ns(np.random.default_rng(0))
        servers.append(PerceptionServer(estimator, samples, StageTimer(), **options))
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
    assert server.dropped == 2


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

    class Slow(Mean):
        def estimate(self, image):
            release.wait(5.0)
            return super().estimate(image)

    server = serve(Slow(), ConstantLatency(latency_ms=1.0))
    server.submit(captured(0, 0))
    threading.Timer(0.05, release.set).start()
    (one,) = server.poll(MS)
    assert one.depth.available_ns == MS


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
