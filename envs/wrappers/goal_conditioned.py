"""A task as a goal to be reached, for learning from goals that were reached by accident."""

from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import ArrayLike

from laploop.arrays import Array, Float32
from laploop.envs.tasks.observations import bounded
from laploop.envs.tasks.tick_record import off_goal
from laploop.envs.wrappers.chain_state import StatefulWrapper
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import invert_transform, transform_points

RewardKind = Literal["sparse", "dense"]


class GoalConditioned(StatefulWrapper):
    """Shows where the tip is as a goal achieved, and where it should be as the goal desired, as Gymnasium-Robotics does.

    The observation is a `Dict` of

    - `observation`, (n,): what the environment observes, as one vector;
    - `achieved_goal`, (3,): the centre of the tip's ball end, metres in the camera's frame;
    - `desired_goal`, (3,): where it touches the target ideally, one ball radius above it along the normal. It moves with the
      tissue.

    Both goals are the simulator's truth. The reward of a step is `compute_reward` of its goals and nothing else, so that
    hindsight experience replay (Andrychowicz and others, arXiv 1707.01495) can compute it anew for other goals; harm still ends
    an episode.
    """

    def __init__(
        self, env: gym.Env[Any, Any], reward: RewardKind = "sparse", distance_threshold_m: float | None = None
    ) -> None:
        """Wrap an environment.

        Args:
            env: That of a task that moves the tool and observes vectors alone.
            reward: sparse (0 within the threshold, -1 outside) or dense (minus the distance in metres).
            distance_threshold_m: By default the success radius of the task when it is wrapped, where it has one.

        Raises:
            InvalidValueError: If it moves the scope or observes images, or the threshold is missing or out of range.
            UnknownNameError: If there is no such reward.
        """
        RecordConstructorArgs.__init__(self, reward=reward, distance_threshold_m=distance_threshold_m)
        super().__init__(env)
        task = self.task_env
        if reward not in get_args(RewardKind):
            raise UnknownNameError("reward", reward, get_args(RewardKind))
        if task.moves_scope:
            raise InvalidValueError("env", task.task, "a task that moves the tool")
        observed = env.observation_space
        vectors = observed.spaces.values() if isinstance(observed, spaces.Dict) else [observed]
        if not all(isinstance(vector, spaces.Box) and len(vector.shape) == 1 for vector in vectors):
            raise InvalidValueError("observation space of GoalConditioned", observed, "vectors alone: the observation state")
        threshold = distance_threshold_m or getattr(task.config, "success_radius_m", None)
        if threshold is None or not 0.0 < threshold <= 1.0:
            raise InvalidValueError("distance_threshold_m", distance_threshold_m, "above 0 and at most 1")
        self._reward = reward
        self.distance_threshold_m = float(threshold)
        """Distance of the goals, metres, up to which the goal is reached."""
        goal = spaces.Box(-1.0, 1.0, (3,), np.float32)
        flat = spaces.flatten_space(observed)
        self.observation_space = spaces.Dict({"observation": flat, "achieved_goal": goal, "desired_goal": goal})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        shown = self._observed(observation)
        return shown, info | {"is_success": self._is_reached(shown["achieved_goal"], shown["desired_goal"])}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step, with the reward of the goals and `is_success` by them."""
        observation, _, terminated, truncated, info = self.env.step(action)
        shown = self._observed(observation)
        achieved, desired = shown["achieved_goal"], shown["desired_goal"]
        info = info | {"is_success": self._is_reached(achieved, desired)}
        return shown, float(self.compute_reward(achieved, desired, info)), terminated, truncated, info

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:  # noqa: ARG002  Gymnasium-Robotics' signature
        """Return the reward of goals, (..., 3) each, metres: (...), float32."""
        distance = _distance_m(achieved_goal, desired_goal)
        if self._reward == "dense":
            return (-distance).astype(np.float32)
        return -(distance > self.distance_threshold_m).astype(np.float32)

    def _is_reached(self, achieved: Float32, desired: Float32) -> bool:
        return bool(_distance_m(achieved, desired) <= self.distance_threshold_m)

    def _observed(self, observation: Any) -> dict[str, Any]:
        task = self.task_env
        offset, _, position = task.target_offset()
        camera_from_world = invert_transform(task.loop.theatre.world_from_camera())
        goal, _, _ = off_goal(task)
        return {
            "observation": np.asarray(spaces.flatten(self.env.observation_space, observation), np.float32),
            "achieved_goal": bounded(transform_points(camera_from_world, position + offset), -1.0, 1.0),
            "desired_goal": bounded(transform_points(camera_from_world, goal), -1.0, 1.0),
        }


def _distance_m(achieved: ArrayLike, desired: ArrayLike) -> Array:
    apart = np.asarray(achieved, np.float64) - np.asarray(desired, np.float64)
    return np.asarray(np.linalg.norm(apart, axis=-1))
