"""An environment whose state can be taken and set, and which copies and pickles by that."""

from abc import abstractmethod
from typing import Any

from laploop.envs.environment_state import EnvironmentState, class_place, laploop_version, packed, unpacked
from laploop.envs.loop.closed_loop import ClosedLoop
from laploop.envs.tasks.steppable_env import SteppableEnv
from laploop.envs.tasks.task_config import TaskConfig
from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import DepthEstimator

_LASTING = {"config", "loop", "action_space", "observation_space", "spec", "perception"}
"""Attributes that belong to no state; all others do, those of a task of your own included."""


class SavableEnv(SteppableEnv):
    """What `TaskEnv` is made of: configuration, estimator and loop, and what changes during an episode.

    `copy.copy`, `copy.deepcopy` and `pickle` make a new environment of the same configuration and set the state. It has threads
    and buffers of its own, and no recorder.
    """

    config: TaskConfig
    loop: ClosedLoop
    perception: str | DepthEstimator
    """The estimator as it was given, a name or an object; states and copies know it by that."""
    _running: bool

    @abstractmethod
    def _make_anew(self, config: Any, perception: str | DepthEstimator) -> None:
        """Make all that does not change during an episode."""

    def get_state(self) -> EnvironmentState:
        """Return everything that shapes the environment's future, between two steps or before the first reset.

        Raises:
            InvalidValueError: If an attribute of a task or a controller of your own cannot be pickled.
        """
        own = {name: value for name, value in vars(self).items() if name not in _LASTING}
        # An environment that was never reset has no generator of its own yet.
        own |= {"_np_random": self._np_random, "_np_random_seed": self._np_random_seed}
        memory = packed({"task": own, "loop": self.loop.memory()}, self._parts())
        scene = self.loop.observed.get_state()
        return EnvironmentState(**self.identity(), version=laploop_version(), scene=scene, memory=memory)

    def set_state(self, state: EnvironmentState) -> None:
        """Go on from a state that an environment like this one was in; a reset before is not needed.

        A scripted controller inside the environment is replaced by a copy, in its state of then. A recorder stays, and sees
        time go on from there.

        Raises:
            InvalidValueError: If it is no state, or one of another task, estimator or configuration.
        """
        if not isinstance(state, EnvironmentState):
            raise InvalidValueError("state", type(state).__name__, "what get_state of an environment has returned")
        state.check(**self.identity())
        self._running = False
        self.loop.set_scene(state.scene)
        memory = unpacked(state.memory, self._parts())
        self.loop.remember(memory["loop"])
        vars(self).update(memory["task"])

    def identity(self) -> dict[str, Any]:
        """Return what a state must share with the environment, as `EnvironmentState.check` takes it."""
        perception = self.perception if isinstance(self.perception, str) else class_place(type(self.perception))
        return {"environment": class_place(type(self)), "perception": perception, "config": self.config}

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: what the environment was made from, but the recorder, and its state."""
        made_from = {"config": self.config, "perception": self.perception, "spec": self.spec}
        return made_from | {"action_space": self.action_space, "state": self.get_state()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self._make_anew(state["config"], state["perception"])
        self.spec, self.action_space = state["spec"], state["action_space"]
        self.set_state(state["state"])

    def _parts(self) -> dict[str, Any]:
        return {"task": self, "config": self.config, **self.loop.parts()}
