"""The times of an episode's frames and stages as CSV."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import COLUMN, MeasuredLatency
from laploop.envs.loop.timing.log import FrameTimes, TimingLog
from laploop.studies.csv_text import csv_text


def frames_csv(log: TimingLog) -> str:
    """Write a row a frame: its `FrameTimes`, in nanoseconds of simulated time; empty where something did not happen."""
    columns = [field.name for field in fields(FrameTimes)]
    return csv_text(columns, (asdict(times).values() for times in log.frames))


def measured_traces(log: TimingLog, timing: TimingConfig) -> Mapping[str, str]:
    """Return a trace for each stage whose time was measured, by the name of its file."""
    stages = {"service": (timing.service, log.service_ns), "compute": (timing.compute, log.compute_ns)}
    return {
        f"{stage}_trace.csv": trace_csv(times_ns)
        for stage, (model, times_ns) in stages.items()
        if isinstance(model, MeasuredLatency)
    }


def trace_csv(times_ns: Sequence[int]) -> str:
    """Write the times of a stage, in nanoseconds, as a trace, which a `TraceLatency` replays to the nanosecond."""
    return csv_text(("frame", COLUMN), ((index, f"{ns * 1e-6:.6f}") for index, ns in enumerate(times_ns)))
