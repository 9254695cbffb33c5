"""What of a loop belongs to a state, and how it takes one over."""

from typing import Any

from laploop.envs.loop.config import LoopConfig
from laploop.envs.loop.frame_renderer import FrameRenderer
from laploop.envs.loop.observed_theatre import ObservedTheatre, SceneState
from laploop.envs.loop.perception_server import PerceptionServer
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.recording.recorder import Recorder
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig


class SavableLoop:
    """The parts of `ClosedLoop` that outlive states, and those that are exchanged with them."""

    config: LoopConfig
    estimator: DepthEstimator
    recorder: Recorder
    rig: Rig
    timer: StageTimer
    observed: ObservedTheatre
    theatre: Theatre
    _renderer: FrameRenderer | None
    _server: PerceptionServer | None
    _lasting: frozenset[str]

    def parts(self) -> dict[str, Any]:
        """Return what outlives states: the objects to which they refer by name."""
        mine = {f"loop.{name}": getattr(self, name) for name in ("config", "estimator", "recorder", "rig", "timer")}
        return {"loop": self, **mine, "loop.rig.camera": self.rig.camera, **self.observed.parts()}

    def memory(self) -> dict[str, Any]:
        """Return what changes from reset on, except theatre and camera (`observed`): not a copy, but nothing is under way."""
        for worker in (self._server, self._renderer):
            if worker is not None:
                worker.settle()
        return {name: value for name, value in vars(self).items() if name not in self._lasting | {"theatre"}}

    def set_scene(self, state: SceneState | None) -> None:
        """End the running episode, and bring theatre and camera into a state; `remember` must follow."""
        self._end_episode()
        if state is not None:
            before, self.theatre = self.observed.theatre, self.observed.set_state(state)
            if self.theatre is not before:
                self.recorder.begin(self.theatre, self.rig)

    def remember(self, memory: dict[str, Any]) -> None:
        """Go on from a copy of what `memory` has returned."""
        vars(self).update(memory)

    def _end_episode(self) -> None:
        for worker in (self._server, self._renderer):
            if worker is not None:
                worker.close()
        self._server = self._renderer = None
