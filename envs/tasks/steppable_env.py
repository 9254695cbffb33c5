"""Environments whose steps stop where physics is computed, so that many of them can advance together."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.theatre.physics_call import PhysicsRun, run_alone

Info = dict[str, Any]
Begin = tuple[Any, Info]
"""What a reset returns: observation and info."""
Step = tuple[Any, float, bool, bool, Info]
"""What a step returns: observation, reward, terminated, truncated, info."""


class SteppableEnv(gym.Env[Any, NDArray[np.float32]]):
    """Gymnasium's interface, and beside it what `laploop.envs.batch` needs of an environment."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Begin:
        """Begin an episode; nothing that was chosen by an earlier seed remains.

        Args:
            seed: Decides everything that is random in the episode.
            options: What is chosen by hand, as `target_pixel`: (column, row); `reset_options` names all.

        Raises:
            UnknownNameError: If there is no such option.
            InvalidValueError: If the seed is not an integer from 0 on, or the chosen pixel shows no tissue.
        """
        return run_alone(self.resetting(seed=seed, options=options))

    def step(self, action: NDArray[np.floating[Any]]) -> Step:
        """Follow an action for one step.

        Raises:
            InvalidValueError: If the action has another shape, or an entry that is not finite where that is an error.
            SimulationError: If the episode has ended or not begun.
        """
        return run_alone(self.stepping(action))

    @abstractmethod
    def resetting(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> PhysicsRun[Begin]:
        """As `reset`, stopping where MuJoCo computes."""

    @abstractmethod
    def stepping(self, action: NDArray[np.floating[Any]]) -> PhysicsRun[Step]:
        """As `step`, stopping where MuJoCo computes."""

    @property
    @abstractmethod
    def action_check(self) -> Callable[[object], Array]:
        """What raises those errors of `step` that come before anything moves, given an action; picklable."""

    def seed_generator(self, seed: int | None) -> None:
        """Seed the environment's generator as Gymnasium does; without a seed it goes on."""
        super().reset(seed=None if seed is None else int(seed))

    @abstractmethod
    def share_cores(self) -> None:
        """Leave the other cores to other environments: images take one thread; call it before the first `reset`."""
