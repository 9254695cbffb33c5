from itertools import islice

import numpy as np
import pytest

from laploop.envs.loop.timing.latency import (
    ConstantLatency,
    GammaLatency,
    LognormalLatency,
    NormalLatency,
    TraceLatency,
    measured_ns,
)
from laploop.errors import InvalidValueError, LaploopError, MissingFileError


def drawn(latency, count, seed=0):
    return list(islice(latency.samples_ns(np.random.default_rng(seed)), count))


def test_constant_latency_is_constant():
    assert drawn(ConstantLatency(latency_ms=0.007), 3) == [7_000, 7_000, 7_000]


def test_lognormal_latency_has_its_median_and_repeats_with_the_seed():
    latency = LognormalLatency(median_ms=1.0, sigma=0.3)
    samples = drawn(latency, 4000)
    # The median's standard error is 1.25 * sigma / sqrt(n) = 0.6 %.
    assert np.median(samples) == pytest.approx(1_000_000, rel=0.03)
    assert samples[:5] == drawn(latency, 5)


def test_normal_and_gamma_latencies_have_their_mean_and_spread_and_repeat_with_the_seed():
    for latency in (NormalLatency(mean_ms=10.0, sd_ms=2.0), GammaLatency(mean_ms=10.0, sd_ms=2.0)):
        samples = np.array(drawn(latency, 4000)) * 1e-6
        # Standard errors: of the mean 2 / sqrt(4000) = 0.03 ms, of the deviation about 0.7 of that.
        assert samples.mean() == pytest.approx(10.0, abs=0.13)
        assert samples.std() == pytest.approx(2.0, abs=0.12)
        assert drawn(latency, 5) == drawn(latency, 5) != drawn(latency, 5, seed=1)
        assert latency.typical_ns == 10_000_000
    # A gamma distribution is skewed by twice the ratio of deviation and mean, a normal one not.
    assert ((samples - samples.mean()) ** 3).mean() / samples.std() ** 3 == pytest.approx(0.4, abs=0.2)


def test_random_latencies_are_cut_at_0_and_at_their_maximum():
    samples = drawn(NormalLatency(mean_ms=1.0, sd_ms=2.0, max_ms=2.5), 500)
    assert (min(samples), max(samples)) == (0, 2_500_000)


def test_a_latency_is_held_with_its_probability():
    samples = np.array(drawn(LognormalLatency(sigma=0.5, hold_probability=0.75), 4000))
    held = (np.diff(samples) == 0).mean()
    # The standard error is sqrt(0.75 * 0.25 / 4000) = 0.7 %.
    assert held == pytest.approx(0.75, abs=0.03)
    assert (np.diff(drawn(LognormalLatency(sigma=0.5), 100)) != 0).all()


def test_a_trace_that_is_replayed_once_says_when_it_is_over_and_how_long_it_is():
    samples = TraceLatency(latencies_ms=(1.0, 2.0, 3.0), order="in-order").samples_ns(np.random.default_rng(0))
    assert [next(samples) for _ in range(3)] == [1_000_000, 2_000_000, 3_000_000]
    with pytest.raises(InvalidValueError, match=r"'in-order'; allowed: .* the trace holds 3 times"):
        next(samples)


def test_a_shuffled_trace_gives_every_time_once_a_pass_in_an_order_of_the_seed():
    trace = TraceLatency(latencies_ms=tuple(float(ms) for ms in range(20)), order="shuffle")
    first, second = np.reshape(drawn(trace, 40), (2, 20))
    assert sorted(first) == sorted(second) == [ms * 1_000_000 for ms in range(20)]
    assert list(first) != list(second)
    assert drawn(trace, 40) == drawn(trace, 40) != drawn(trace, 40, seed=1)


def test_a_measured_time_is_one_that_a_trace_can_hold():
    assert measured_ns(0.0123456789) == 12_345_679
    assert measured_ns(9.0) == 5_000_000_000


def test_a_trace_is_replayed_in_order_and_starts_over():
    assert drawn(TraceLatency(latencies_ms=(1.0, 2.0, 3.0)), 5) == [1_000_000, 2_000_000, 3_000_000, 1_000_000, 2_000_000]


def test_two_loops_of_one_trace_do_not_draw_from_each_other():
    trace = TraceLatency(latencies_ms=(1.0, 2.0, 3.0))
    one, other = trace.samples_ns(np.random.default_rng(0)), trace.samples_ns(np.random.default_rng(0))
    assert [next(one), next(one), next(other), next(one)] == [1_000_000, 2_000_000, 1_000_000, 3_000_000]


def test_a_trace_is_read_from_csv_in_milliseconds(tmp_path):
    path = tmp_path / "trace.csv"
    path.write_text("frame,latency_ms\n0,38.4\n1,40\n\n")
    assert TraceLatency.from_csv(path).latencies_ms == (38.4, 40.0)
    path.write_bytes("\ufefflatency_ms\r\n1.5\r\n".encode())
    assert drawn(TraceLatency.from_csv(path), 1) == [1_500_000]


BAD_TRACES = {
    "binary": bytes(range(256)),
    "UTF-16": "latency_ms\n40\n".encode("utf-16"),
    "UTF-16 without a mark": "latency_ms\n40\n".encode("utf-16-le"),
    "a huge field": b"latency_ms\n" + b"4" * 200_000 + b"\n",
    "a decimal comma": b"latency_ms\n40,5\n",
    "a gap": b"latency_ms\n40\n\n50\n",
    "text": b"latency_ms\nfast\n",
    "not a number": b"latency_ms\nnan\n",
    "infinite": b"latency_ms\ninf\n",
    "negative": b"latency_ms\n-1\n",
    "another column": b"frame,ms\n0,1\n",
    "a row too short": b"frame,latency_ms\n0,40\n1\n",
    "an open quote": b'latency_ms\n"40\n',
    "no rows": b"latency_ms\n",
    "empty": b"",
}


@pytest.mark.parametrize("name", BAD_TRACES)
def test_a_damaged_trace_is_refused_in_one_line_that_names_the_file(tmp_path, name):
    path = tmp_path / "bad.csv"
    path.write_bytes(BAD_TRACES[name])
    with pytest.raises(InvalidValueError, match=r"latency trace .*bad\.csv is ") as caught:
        TraceLatency.from_csv(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250 + len(str(path))


def test_a_missing_trace_is_named(tmp_path):
    for path in (tmp_path / "none.csv", tmp_path, "x" * 300):
        with pytest.raises((MissingFileError, InvalidValueError), match="latency trace"):
            TraceLatency.from_csv(path)


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        (ConstantLatency, {"latency_ms": -1.0}),
        (ConstantLatency, {"latency_ms": float("nan")}),
        (LognormalLatency, {"sigma": -0.1}),
        (LognormalLatency, {"median_ms": 0.0}),
        (NormalLatency, {"sd_ms": -1.0}),
        (NormalLatency, {"hold_probability": 1.0}),
        (GammaLatency, {"mean_ms": 0.0}),
        (LognormalLatency, {"max_ms": 6000.0}),
        (TraceLatency, {"order": "backwards", "latencies_ms": (1.0,)}),
        (TraceLatency, {"latencies_ms": ()}),
        (TraceLatency, {"latencies_ms": (3.0, -1.0)}),
    ],
)
def test_out_of_range_parameters_are_refused(kind, fields):
    with pytest.raises(LaploopError, match=next(iter(fields))):
        kind(**fields)
