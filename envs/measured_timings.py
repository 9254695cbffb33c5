"""Timings of the depth networks as they were measured: traces that `laploop speed` left, replayed in a loop.

Each was taken on one thread of a two-core AMD EPYC that did nothing else, with the network alone. `laploop speed` makes one for
your machine.
"""

from importlib.resources import files
from pathlib import Path

from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import TraceLatency
from laploop.envs.timing_presets import TimingPreset

TRACES = Path(str(files("laploop.envs.loop.timing") / "traces"))
"""Folder of the traces, one CSV file a network."""


def _measured(network: str) -> TimingPreset:
    trace = TraceLatency.from_csv(TRACES / f"{network}.csv")
    source = f"{network} on one thread of an AMD EPYC, median {trace.typical_ns / 1e6:.1f} ms; traced by `laploop speed`"
    return TimingPreset(timing=TimingConfig(service=trace), source=source)


COMPACT = _measured("compact")
SSLE_PHASE = _measured("ssle-phase")
SSLE = _measured("ssle")
DUAL_UNET = _measured("dual-unet")
