"""An episode kept in memory, small however long it lasts."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from laploop.envs.loop.timing.log import TimingLog
from laploop.envs.recording.recorder import DepthRecord, Recorder, TickRecord
from laploop.perception.geometry import Rig

if TYPE_CHECKING:
    from laploop.envs.theatre.theatre import Theatre

MAX_KEPT = 16
"""Depth records kept at most (0.7 MB each at 256x256)."""


class EpisodeLog(Recorder):
    """A recorder that keeps every tick and a few evenly spaced depth records.

    How long an episode lasts is known only at its end, so depth records are kept at a stride that doubles whenever
    `MAX_KEPT` of them are held; the newest is always kept.
    """

    def __init__(self) -> None:
        self.rig: Rig | None = None
        self.ticks: list[TickRecord] = []
        self.times = TimingLog()
        self._kept: list[DepthRecord] = []
        self._stride = 1
        self._depth_count = 0
        self._newest: DepthRecord | None = None

    def begin(self, theatre: "Theatre", rig: Rig) -> None:  # noqa: ARG002 (the recorder protocol names it)
        """Remember the rig."""
        self.rig = rig

    def tick(self, record: TickRecord) -> None:
        """Keep a tick."""
        self.ticks.append(record)

    def depth(self, record: DepthRecord) -> None:
        """Keep the record if it falls on the stride."""
        if self._depth_count % self._stride == 0:
            if len(self._kept) == MAX_KEPT:
                del self._kept[1::2]
                self._stride *= 2
            if self._depth_count % self._stride == 0:
                self._kept.append(record)
        self._newest = record
        self._depth_count += 1

    def timing(self, log: TimingLog) -> None:
        """Keep the times of frames and commands."""
        self.times = log

    def key_depths(self) -> tuple[DepthRecord, ...]:
        """Return the first, the middle and the last depth record; fewer, without repetition, when fewer arrived."""
        if self._newest is None:
            return ()
        first, last = self._kept[0], self._newest
        half_ns = (first.now_ns + last.now_ns) / 2
        middle = min(self._kept, key=lambda record: abs(record.now_ns - half_ns))
        unique = {record.depth.index: record for record in (first, middle, last)}
        return tuple(unique.values())

    def times_s(self) -> NDArray[np.float64]:
        """Simulated times of the ticks, (n,), seconds."""
        return np.array([tick.now_ns * 1e-9 for tick in self.ticks], dtype=np.float64)

    def series(self, name: str) -> NDArray[np.float64]:
        """Return one quantity at all ticks, (n,), in the unit that its name ends in; NaN where it was not measured.

        Args:
            name: A number of `TickRecord`, as `contact_force_n`, or one key of a mapping in it, as `rcm_error_mm/tool`.
        """
        field, _, key = name.partition("/")
        values = [getattr(tick, field) for tick in self.ticks]
        if key:
            values = [value.get(key) for value in values]
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
