"""The times of an episode as Chrome trace events, which Perfetto and chrome://tracing open.

Stages are tracks: a stage that handles several frames or commands at once has as many as it needs. Arrows lead a frame from one
stage to the next, up to the control tick that first knew it. Times are simulated, in microseconds as the format has it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.log import CommandTimes, FrameTimes, TimingLog

Event = dict[str, Any]

_PERCEPTION, _CONTROL = 1, 2
_PROCESSES = {_PERCEPTION: "perception", _CONTROL: "control"}
_TRACKS_A_STAGE = 1000
"""Numbers set aside for each stage."""


@dataclass(kw_only=True)
class _Slice:
    """What one stage did for one frame or command."""

    process: int
    stage: str
    name: str
    begin_ns: int
    end_ns: int
    more: Event = field(default_factory=dict)
    track: int = 0

    def event(self) -> Event:
        """Return the complete event."""
        timing = {"ts": _us(self.begin_ns), "dur": _us(self.end_ns - self.begin_ns)}
        return {"ph": "X", "name": self.name, "cat": self.stage, **timing, **self.place(), "args": self.more}

    def place(self) -> Event:
        """Return the process and the track."""
        return {"pid": self.process, "tid": self.track}


def chrome_trace(log: TimingLog, timing: TimingConfig) -> Event:
    """Return an episode's times in the JSON object format of Chrome's trace events."""
    flights = [list(_flight(times, timing)) for times in log.frames]
    ticks = {times.tick_ns: list(_tick(times)) for times in log.commands}
    slices = [one for group in (*flights, *ticks.values()) for one in group]
    names = list(_names(_with_tracks(slices, timing.workers)))
    events = [one.event() for one in slices]
    for times, flight in zip(log.frames, flights, strict=True):
        events += _arrows(times, flight, ticks)
        if times.available_ns is None:
            last = flight[-1]
            words = times.dropped or "under way at the end"
            events.append({"ph": "i", "s": "t", "name": f"frame {words}", "ts": _us(last.end_ns), **last.place()})
    events += [{"ph": "i", "s": "t", "name": "tick", "ts": _us(ns), **control.place()} for ns, (control, _) in ticks.items()]
    return {"traceEvents": [*names, *sorted(events, key=lambda event: event["ts"])], "displayTimeUnit": "ms"}


def _flight(times: FrameTimes, timing: TimingConfig) -> Iterator[_Slice]:
    """Yield the slices of a frame, as far as it came."""
    departed_ns = times.captured_ns + timing.departure_ns
    stages = (
        # The first exposure begins before the episode does.
        ("camera", max(times.captured_ns - timing.exposure_ns // 2, 0), departed_ns),
        ("transfer", departed_ns, times.arrived_ns),
        ("queue", times.arrived_ns, times.started_ns),
        (f"worker {times.worker}", times.started_ns, times.finished_ns),
        ("pipeline", times.finished_ns, times.available_ns),
    )
    for stage, begin_ns, end_ns in stages:
        if begin_ns is None or end_ns is None:
            return
        more = {"frame": times.index, "dropped": times.dropped}
        name = f"frame {times.index}"
        yield _Slice(process=_PERCEPTION, stage=stage, name=name, begin_ns=begin_ns, end_ns=end_ns, more=more)


def _tick(times: CommandTimes) -> Iterator[_Slice]:
    """Yield the slices of a control tick's command."""
    more = {"overtaken": times.overtaken}
    yield _Slice(process=_CONTROL, stage="control", name="command", begin_ns=times.tick_ns, end_ns=times.computed_ns)
    yield _Slice(
        process=_CONTROL,
        stage="transport",
        name="command",
        begin_ns=times.computed_ns,
        end_ns=times.effective_ns,
        more=more,
    )


def _with_tracks(slices: Sequence[_Slice], workers: int) -> dict[tuple[int, str, int], int]:
    """Give each slice a track on which it overlaps no other; return the tracks by process, stage and row."""
    stages = ["camera", "transfer", "queue", *(f"worker {number}" for number in range(workers)), "pipeline"]
    order = {stage: number for number, stage in enumerate([*stages, "control", "transport"])}
    tracks: dict[tuple[int, str, int], int] = {}
    ends: dict[str, list[int]] = {stage: [] for stage in order}
    for one in sorted(slices, key=lambda one: (order[one.stage], one.begin_ns, one.end_ns)):
        rows = ends[one.stage]
        row = next((row for row, end_ns in enumerate(rows) if end_ns <= one.begin_ns), len(rows))
        rows[row:] = [one.end_ns, *rows[row + 1 :]]
        one.track = order[one.stage] * _TRACKS_A_STAGE + row + 1
        tracks[one.process, one.stage, row] = one.track
    return tracks


def _names(tracks: dict[tuple[int, str, int], int]) -> Iterator[Event]:
    """Yield the events that name processes and tracks, and put these in order."""
    for process, name in _PROCESSES.items():
        yield {"ph": "M", "name": "process_name", "pid": process, "tid": 0, "args": {"name": name}}
    for (process, stage, row), track in tracks.items():
        place = {"pid": process, "tid": track}
        yield {"ph": "M", "name": "thread_name", **place, "args": {"name": f"{stage} ({row + 1})" if row else stage}}
        yield {"ph": "M", "name": "thread_sort_index", **place, "args": {"sort_index": track}}


def _arrows(times: FrameTimes, flight: Sequence[_Slice], ticks: dict[int, list[_Slice]]) -> Iterator[Event]:
    """Yield the arrows of a frame: a start, the steps between, and the end where a control tick first knew it."""
    user = ticks.get(times.first_used_ns) if times.first_used_ns is not None else None
    stops = [*flight, *(user[:1] if user else [])]
    for number, one in enumerate(stops if len(stops) > 1 else []):
        phase = "s" if number == 0 else "f" if number == len(stops) - 1 else "t"
        arrow = {"ph": phase, "name": "frame", "cat": "frame", "id": times.index, "ts": _us(one.begin_ns), **one.place()}
        # The end belongs to the slice around it, and not to the next one.
        yield arrow | ({"bp": "e"} if phase == "f" else {})


def _us(nanoseconds: int) -> float:
    return nanoseconds / 1000
