"""Episodes as they happen, in a Rerun viewer."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from laploop.envs.loop.timing.log import TimingLog
from laploop.envs.recording.recorder import DepthRecord, FrameRecord, PredictionRecord, Recorder, TickRecord
from laploop.envs.recording.rerun_recorder import RerunRecorder
from laploop.envs.recording.viewer import live_viewer
from laploop.perception.geometry import Rig

if TYPE_CHECKING:
    from laploop.envs.theatre.theatre import Theatre


class RerunViewer(Recorder):
    """Shows one episode after the other, each as a recording of its own; opens a viewer if none is open."""

    def __init__(self) -> None:
        self._folder: TemporaryDirectory[str] | None = None
        self._episode: RerunRecorder | None = None

    def begin(self, theatre: "Theatre", rig: Rig) -> None:
        """Show the scene of a new episode.

        Raises:
            InfeasibleError: If no viewer listens and there is no display for a new one.
        """
        if self._folder is None:
            self._folder = TemporaryDirectory(prefix="laploop-")
        if self._episode is not None:
            self._episode.close()
        # The file keeps what the viewer has not taken yet; the next episode replaces it.
        self._episode = RerunRecorder(Path(self._folder.name) / "episode.rrd", live=live_viewer())
        self._episode.begin(theatre, rig)

    def tick(self, record: TickRecord) -> None:
        """Show a control tick."""
        self._shown().tick(record)

    def prediction(self, record: PredictionRecord) -> None:
        """Show a controller's idea of its target."""
        self._shown().prediction(record)

    def frame(self, record: FrameRecord) -> None:
        """Show a captured frame."""
        self._shown().frame(record)

    def depth(self, record: DepthRecord) -> None:
        """Show a depth frame."""
        self._shown().depth(record)

    def timing(self, log: TimingLog) -> None:
        """Pass the times on."""
        self._shown().timing(log)

    def close(self) -> None:
        """End the newest episode; the viewer stays open."""
        if self._episode is not None:
            self._episode.close()
            self._episode = None
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    def _shown(self) -> Recorder:
        if self._episode is None:
            raise RuntimeError("begin() comes before any record")
        return self._episode
