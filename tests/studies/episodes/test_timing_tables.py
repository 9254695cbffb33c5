from itertools import islice

import numpy as np

from laploop.envs.loop.timing.latency import TraceLatency
from laploop.envs.loop.timing.log import FrameTimes, TimingLog
from laploop.studies.episodes.timing_tables import frames_csv, trace_csv


def test_a_row_a_frame_with_empty_cells_for_what_did_not_happen():
    log = TimingLog(
        frames=[
            FrameTimes(index=0, captured_ns=0, arrived_ns=5, started_ns=6, finished_ns=7, available_ns=8, worker=1),
            FrameTimes(index=1, captured_ns=40_000_000, dropped="lost"),
        ]
    )
    assert frames_csv(log).splitlines() == [
        "index,captured_ns,arrived_ns,started_ns,finished_ns,available_ns,first_used_ns,worker,dropped",
        "0,0,5,6,7,8,,1,",
        "1,40000000,,,,,,,lost",
    ]


def test_a_trace_is_replayed_to_the_nanosecond(tmp_path):
    times_ns = [0, 1, 38_400_000, 4_999_999_999, 123_456_789]
    (tmp_path / "trace.csv").write_text(trace_csv(times_ns))
    trace = TraceLatency.from_csv(tmp_path / "trace.csv")
    assert list(islice(trace.samples_ns(np.random.default_rng(0)), 5)) == times_ns
