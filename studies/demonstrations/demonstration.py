"""One episode in which the expert shows its task."""

from dataclasses import asdict, dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.tasks.registry import environment_id
from laploop.errors import InvalidValueError
from laploop.studies.demonstrations.config import DemonstrationConfig
from laploop.studies.demonstrations.expert import Disturbance, Expert

VECTOR = "state"
"""What an observation that is a vector alone is called beside those that are dictionaries."""

Observations = dict[str, NDArray[Any]]
"""By key, (decisions + 1, ...): the first is that of the reset."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Demonstration:
    """Everything of an episode that a data set holds."""

    observations: Observations
    actions: NDArray[np.float32]
    """(decisions, components), -1 to 1: what was done."""
    expert_actions: NDArray[np.float32]
    """(decisions + 1, components), -1 to 1: what the expert would have done."""
    rewards: NDArray[np.float64]
    """(decisions,)."""
    terminations: NDArray[np.bool_]
    """(decisions,)."""
    truncations: NDArray[np.bool_]
    """(decisions,)."""
    successes: NDArray[np.bool_]
    """(decisions + 1,): `info["is_success"]`."""
    privileged: NDArray[np.float32]
    """(decisions + 1, size): `info["privileged"]`."""
    outcome: dict[str, Any]
    """Seed, success, why it ended, decisions, return, and what was drawn: `randomisation`, `noise`, `pushes`. Plain data."""


def make_learner(config: DemonstrationConfig, **more: Any) -> tuple[gym.Env[Any, Any], LearnerEnv]:
    """Make the environment, and return with it the one inside of Gymnasium's wrappers; `more` are further keywords.

    Raises:
        LaploopError: If a keyword is not allowed.
    """
    env: gym.Env[Any, Any] = gym.make(environment_id(config.task, 1), disable_env_checker=True, **config.keywords, **more)
    learner = env.unwrapped
    if not isinstance(learner, LearnerEnv):
        env.close()
        raise InvalidValueError("task", config.task, f"one whose version 1 is a LearnerEnv, not a {type(learner).__name__}")
    return env, learner


def one_thread() -> None:
    """Let networks compute on one thread: sums of several depend on their number, and episodes must not."""
    import torch  # slow to import

    torch.set_num_threads(1)


def demonstrate(config: DemonstrationConfig, seed: int) -> Demonstration:
    """Run one episode.

    Raises:
        SimulationError: If its physics failed.
        InfeasibleError: If its control did.
        LaploopError: If the environment cannot be made.
    """
    one_thread()
    env, learner = make_learner(config)
    try:
        observed, info = env.reset(seed=seed)
        task = learner.task_env
        expert = Expert(learner)
        decision_s = learner.decision_ticks * task.config.loop.control_s
        disturbance = Disturbance(config.perturbation, seed=seed, max_seconds=task.config.max_seconds, decision_s=decision_s)
        seen, infos, wanted, done = [observed], [info], [expert.action()], []
        steps: list[tuple[float, bool, bool]] = []
        while not steps or not (steps[-1][1] or steps[-1][2]):
            done.append(disturbance.disturbed(wanted[-1], len(steps) * decision_s))
            observed, reward, terminated, truncated, info = env.step(done[-1])
            seen.append(observed)
            infos.append(info)
            steps.append((float(reward), terminated, truncated))
            wanted.append(expert.action())
    finally:
        env.close()
    rewards, terminations, truncations = zip(*steps, strict=True)
    return Demonstration(
        observations=stacked(seen),
        actions=np.stack(done),
        expert_actions=np.stack(wanted),
        rewards=np.array(rewards, np.float64),
        terminations=np.array(terminations, np.bool_),
        truncations=np.array(truncations, np.bool_),
        successes=np.array([one["is_success"] for one in infos], np.bool_),
        privileged=np.stack([one["privileged"] for one in infos]),
        outcome={
            "seed": seed,
            "success": bool(infos[-1]["is_success"]),
            "terminated_by": infos[-1]["terminated_by"],
            "decisions": len(steps),
            "return": float(sum(rewards)),
            "randomisation": infos[0]["randomisation"],
            "noise": disturbance.noise,
            "pushes": [asdict(push) for push in disturbance.pushes],
        },
    )


def stacked(observed: list[Any]) -> Observations:
    """Return observations by key, along a first axis."""
    if isinstance(observed[0], dict):
        return {key: np.stack([one[key] for one in observed]) for key in observed[0]}
    return {VECTOR: np.stack(observed)}
