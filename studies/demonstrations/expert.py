"""The scripted controller of a task as a learner's policy would be, and what leads it off its path."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.configuration import to_plain
from laploop.control.controllers.base import TaskController
from laploop.control.controllers.registry import make_controller
from laploop.control.messages import TipController
from laploop.envs.composer_modules import composer_module
from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.tasks.registry import task_spec
from laploop.studies.demonstrations.config import Perturbation

Action = NDArray[np.float32]

_STREAM = 89
"""Keeps the random numbers apart from those of the episode itself, whose seed is the same integer."""


class Expert:
    """Asks the task's scripted controller once a decision; its answer is held for as long as a policy's would be."""

    def __init__(self, env: LearnerEnv) -> None:
        """Take an environment whose episode has just begun."""
        self._env = env
        self.controller: TipController = make_controller(task_spec(env.task_env.task).controller, env.task_env.loop.rig)
        self.controller.reset()

    def action(self) -> Action:
        """Return what the controller would do now, -1 to 1 a component."""
        command = self.controller.command(self._env.task_env.control_input())
        return np.clip(command / self._env.action_scale, -1.0, 1.0).astype(np.float32)

    @property
    def parameters(self) -> dict[str, Any]:
        """The controller's name and what it was made with."""
        name = task_spec(self._env.task_env.task).controller
        config = to_plain(self.controller.config) if isinstance(self.controller, TaskController) else None
        return {"controller": name, "config": config}


@dataclass(frozen=True)
class Push:
    """A moment in which another action takes the place of the expert's."""

    begin_s: float
    action: tuple[float, float, float]


class Disturbance:
    """Noise on the actions of an episode and pushes in between, drawn from its seed."""

    def __init__(self, config: Perturbation, *, seed: int, max_seconds: float, decision_s: float) -> None:
        """Draw how much of it there is.

        Args:
            config: The most of it.
            seed: The episode's.
            max_seconds: Longest time that an episode may take.
            decision_s: From one action to the next.
        """
        state = np.random.RandomState(np.random.MT19937(np.random.SeedSequence((seed, _STREAM))))
        self._config, self._state, self._decision_s = config, state, decision_s
        self.noise = float(config.noise * state.uniform())
        """Standard deviation of the noise."""
        walk = composer_module("variation.distributions").BiasedRandomWalk
        self._walks = [walk(stdev=self.noise, timescale=config.noise_s / decision_s) for _ in range(3)]
        count = int(state.randint(config.pushes + 1))
        begins = np.sort(state.uniform(0.0, config.push_fraction * max_seconds, count))
        self.pushes = [Push(float(begin), self._drawn_push()) for begin in begins]

    def disturbed(self, action: Action, time_s: float) -> Action:
        """Return what is done in place of an expert's action, -1 to 1 a component; call it once a decision."""
        noise = np.array([walk(random_state=self._state) for walk in self._walks])
        pushed = next((push.action for push in self.pushes if self._lasts(push, time_s)), action)
        return np.clip(pushed + noise, -1.0, 1.0).astype(np.float32)

    def _lasts(self, push: Push, time_s: float) -> bool:
        return push.begin_s <= time_s < push.begin_s + max(self._config.push_s, self._decision_s)

    def _drawn_push(self) -> tuple[float, float, float]:
        """Draw a direction evenly from the half that leads away from the tissue, which lies along the camera's z."""
        direction: Array = self._state.normal(size=3)
        x, y, z = (self._config.push * direction / max(math.hypot(*direction), 1e-12)).tolist()
        return x, y, -abs(z)
