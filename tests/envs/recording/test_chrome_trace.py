"""Traces against the format that Perfetto reads: the JSON object format of the trace events of Chrome."""

import json
from collections import defaultdict
from itertools import pairwise

import pytest

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency
from laploop.envs.loop.timing.log import CommandTimes, FrameTimes, TimingLog
from laploop.envs.recording.chrome_trace import chrome_trace

MS = 1_000_000
TIMING = TimingConfig(
    exposure_ms=10.0, readout_ms=3.0, transfer=ConstantLatency(latency_ms=50.0), queue="fifo", capacity=2, workers=2
)


def frame(index, arrived=None, started=None, finished=None, available=None, used=None, **more):
    times = (None if ms is None else round(ms * MS) for ms in (arrived, started, finished, available, used))
    names = ("arrived_ns", "started_ns", "finished_ns", "available_ns", "first_used_ns")
    return FrameTimes(index=index, captured_ns=index * 40 * MS, **dict(zip(names, times, strict=True)), **more)


@pytest.fixture(scope="module")
def events():
    log = TimingLog(
        frames=[
            frame(0, 58, 58, 98, 98.5, 104, worker=0),
            # Transferred while frame 0 still is, served while that is too, and then overtaken.
            frame(1, 98, 98, 138, 140, worker=1, dropped="overtaken"),
            frame(2, 138, 138.5, 178.5, 179, worker=0),
            frame(3, dropped="lost"),
        ],
        commands=[
            CommandTimes(tick_ns=ms * MS, computed_ns=(ms + 12) * MS, arrived_ns=(ms + 13) * MS, effective_ns=(ms + 14) * MS)
            for ms in (96, 104, 112)
        ],
    )
    text = json.dumps(chrome_trace(log, TIMING), allow_nan=False)
    trace = json.loads(text)
    assert trace["displayTimeUnit"] in {"ms", "ns"}
    return trace["traceEvents"]


def test_every_event_has_what_its_phase_needs(events):
    needed = {
        "M": {"name", "args"},
        "X": {"name", "cat", "ts", "dur", "args"},
        "i": {"name", "ts", "s"},
        "s": {"name", "cat", "id", "ts"},
        "t": {"name", "cat", "id", "ts"},
        "f": {"name", "cat", "id", "ts", "bp"},
    }
    assert {event["ph"] for event in events} == set(needed)
    for event in events:
        assert event.keys() >= needed[event["ph"]] | {"pid", "tid"}
        assert isinstance(event["pid"], int)
        assert isinstance(event["tid"], int)
        assert event.get("ts", 0.0) >= 0.0
        assert event.get("dur", 0.0) >= 0.0
        assert event.get("s", "t") in {"g", "p", "t"}
        assert event.get("bp", "e") == "e"


def test_times_are_microseconds(events):
    slices = {(event["cat"], event["name"]): (event["ts"], event["dur"]) for event in events if event["ph"] == "X"}
    assert slices["camera", "frame 0"] == (0.0, 8000.0)
    assert slices["camera", "frame 1"] == (35_000.0, 13_000.0)
    assert slices["transfer", "frame 0"] == (8000.0, 50_000.0)
    assert slices["worker 1", "frame 1"] == (98_000.0, 40_000.0)
    assert slices["queue", "frame 2"] == (138_000.0, 500.0)
    assert slices["pipeline", "frame 0"] == (98_000.0, 500.0)
    assert [event["ts"] for event in events if event["name"] == "tick"] == [96_000.0, 104_000.0, 112_000.0]


def test_every_track_and_process_has_a_name_and_stages_have_their_order(events):
    names = {(e["pid"], e["tid"]): e["args"]["name"] for e in events if e["name"] == "thread_name"}
    assert {(event["pid"], event["tid"]) for event in events if event["ph"] != "M"} == set(names)
    assert {e["pid"]: e["args"]["name"] for e in events if e["name"] == "process_name"} == {1: "perception", 2: "control"}
    order = {e["tid"]: e["args"]["sort_index"] for e in events if e["name"] == "thread_sort_index"}
    shown = [name for (_, track), name in sorted(names.items(), key=lambda item: order[item[0][1]])]
    assert shown == [
        *("camera", "transfer", "transfer (2)", "queue", "worker 0", "worker 1", "pipeline"),
        *("control", "control (2)", "transport"),
    ]


def test_slices_of_a_track_do_not_overlap(events):
    tracks = defaultdict(list)
    for event in events:
        if event["ph"] == "X":
            tracks[event["pid"], event["tid"]].append((event["ts"], event["ts"] + event["dur"]))
    for slices in tracks.values():
        assert all(before[1] <= after[0] for before, after in pairwise(sorted(slices)))


def test_arrows_lead_each_frame_through_its_stages_to_its_first_user(events):
    slices = [event for event in events if event["ph"] == "X"]
    arrows = defaultdict(list)
    for event in events:
        if event["ph"] in "stf":
            arrows[event["id"]].append(event)
    found = {}
    for index, ends in arrows.items():
        assert [end["ph"] for end in ends] == ["s", *"t" * (len(ends) - 2), "f"]
        # Each end lies in a slice, to which it is bound.
        found[index] = [
            next(
                one["cat"]
                for one in slices
                if one["pid"] == end["pid"] and one["tid"] == end["tid"] and one["ts"] <= end["ts"] <= one["ts"] + one["dur"]
            )
            for end in ends
        ]
    assert found[0] == ["camera", "transfer", "queue", "worker 0", "pipeline", "control"]
    assert found[1] == ["camera", "transfer", "queue", "worker 1", "pipeline"]
    assert set(found) == {0, 1, 2}


def test_what_became_of_a_frame_that_did_not_come_through_is_marked(events):
    assert [(e["name"], e["ts"]) for e in events if e["ph"] == "i" and e["name"] != "tick"] == [("frame lost", 128_000.0)]
