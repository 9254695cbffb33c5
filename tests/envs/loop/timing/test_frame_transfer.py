from types import SimpleNamespace

import numpy as np

from laploop.envs.loop.timing.config import TimingConfig, TimingSamples
from laploop.envs.loop.timing.frame_transfer import FrameTransfer
from laploop.envs.loop.timing.latency import ConstantLatency, TraceLatency
from laploop.envs.loop.timing.log import FrameTimes, TimingLog

MS = 1_000_000


def transfer_of(log=None, **timing):
    config = TimingConfig(**timing)
    samples = TimingSamples.draw(config, np.random.default_rng(0), np.random.default_rng(1))
    return FrameTransfer(config, samples, log or TimingLog())


def frame(transfer, index):
    """Make a frame of 40 ms times its index, and send it."""
    captured_ns = index * 40 * MS
    times = FrameTimes(index=index, captured_ns=captured_ns)
    made = SimpleNamespace(index=index, available_ns=transfer.arrival_ns(captured_ns), times=times)
    transfer.send(made)
    return made


def test_half_the_exposure_readout_and_transfer_lie_between_capture_and_arrival():
    transfer = transfer_of(exposure_ms=15.0, readout_ms=2.0, transfer=ConstantLatency(latency_ms=10.0))
    assert transfer.arrival_ns(40 * MS) == 59_500_000


def test_frames_arrive_in_the_order_of_their_arrival():
    transfer = transfer_of(transfer=TraceLatency(latencies_ms=(60.0, 5.0, 60.0)))
    for index in range(3):
        frame(transfer, index)
    assert transfer.newest is None
    assert [one.index for one in transfer.arrived(44 * MS)] == []
    assert [one.index for one in transfer.arrived(60 * MS)] == [1, 0]
    assert transfer.newest.index == 1
    assert [one.index for one in transfer.arrived(140 * MS)] == [2]


def test_lost_frames_never_arrive_and_the_first_is_never_lost():
    log = TimingLog()
    transfer = transfer_of(log, drop_rate=0.999)
    made = [frame(transfer, index) for index in range(5)]
    assert [one.index for one in transfer.arrived(1000 * MS)] == [0]
    assert [one.times.dropped for one in made] == [None, *["lost"] * 4]
    assert log.dropped == {"lost": 4}
