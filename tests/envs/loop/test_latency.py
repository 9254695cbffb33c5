import numpy as np
import pytest

from laploop.envs.loop.latency import ConstantLatency, LognormalLatency, TraceLatency
from laploop.errors import InvalidValueError, MissingFileError


def test_constant_latency_is_constant():
    latency = ConstantLatency(latency_ns=7)
    assert [latency.sample_ns(np.random.default_rng(0)) for _ in range(3)] == [7, 7, 7]


def test_lognormal_latency_has_its_median_and_repeats_with_the_seed():
    latency = LognormalLatency(median_ns=1_000_000, sigma=0.3)
    rng = np.random.default_rng(0)
    samples = [latency.sample_ns(rng) for _ in range(4000)]
    # The median's standard error is 1.25 * sigma / sqrt(n) = 0.6 %.
    assert np.median(samples) == pytest.approx(1_000_000, rel=0.03)
    assert samples[0] == latency.sample_ns(np.random.default_rng(0))


def test_a_trace_is_replayed_in_order_and_starts_over():
    trace = TraceLatency([1, 2, 3])
    rng = np.random.default_rng(0)
    assert [trace.sample_ns(rng) for _ in range(5)] == [1, 2, 3, 1, 2]
    trace.reset()
    assert trace.sample_ns(rng) == 1


def test_a_trace_is_read_from_csv_in_milliseconds(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("frame,latency_ms\n0,38.4\n1,40\n")
    trace = TraceLatency.from_csv(path)
    assert trace.sample_ns(np.random.default_rng(0)) == 38_400_000


def test_bad_traces_get_a_clear_error(tmp_path):
    with pytest.raises(MissingFileError, match="latency trace not found"):
        TraceLatency.from_csv(tmp_path / "none.csv")
    for text in ("frame,ms\n0,1\n", "latency_ms\nfast\n", "latency_ms\nnan\n"):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(InvalidValueError, match="latency_ms"):
            TraceLatency.from_csv(tmp_path / "bad.csv")
    with pytest.raises(InvalidValueError, match="none negative"):
        TraceLatency([3, -1])


def test_out_of_range_parameters_are_refused():
    with pytest.raises(InvalidValueError, match="latency_ns is -1"):
        ConstantLatency(latency_ns=-1)
    with pytest.raises(InvalidValueError, match="sigma"):
        LognormalLatency(sigma=-0.1)
    with pytest.raises(InvalidValueError, match="median_ns"):
        LognormalLatency(median_ns=0)
