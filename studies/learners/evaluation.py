"""How good a policy is: episodes that no training saw, and what they add up to."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.studies.episodes.trials import wilson_interval
from laploop.studies.sweeps.bootstrap import estimate
from laploop.studies.timing.machine import describe_machine
from laploop.whole_file import whole_file

UNSEEN_SEED = 1_000_000
"""Of the first episode of an evaluation. Training seeds its environments with smaller numbers."""
RESULT = "summary.json"

Policy = Callable[[Any], NDArray[np.floating[Any]]]
"""From an observation to an action. One that remembers has a method `reset()`, called before each episode."""

_QUANTITIES = ("total_return", "steps", "error_mm", "force_n")


@dataclass(frozen=True, kw_only=True)
class EpisodeScore:
    """What came of an episode."""

    seed: int
    success: bool
    terminated_by: str | None
    total_return: float
    steps: int
    error_mm: float
    """Target error at the end."""
    force_n: float
    """Largest on the tip."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """How a policy came about."""

    method: str
    environment: str
    """Gymnasium's id."""
    keywords: Mapping[str, Any]
    """What the environment was made with."""
    seed: int
    steps: int
    """Decisions in the environment, or passes through the data of a learner without one."""
    wall_s: float
    cpu_s: float
    """Of the process that learns."""


def evaluate(
    policy: Policy, env: gym.Env[Any, Any], episodes: int, progress: Callable[[int], None] | None = None
) -> list[EpisodeScore]:
    """Run a policy on the episodes of the seeds from `UNSEEN_SEED` on, one after another.

    Args:
        policy: Asked once a step; its `reset()`, if it has one, is called before each episode.
        env: An environment of a task for learners, wrapped or not.
        episodes: How many.
        progress: Called with the number of episodes so far.

    Raises:
        InvalidValueError: If there are no episodes.
    """
    if episodes < 1:
        raise InvalidValueError("episodes", episodes, "1 or more")
    scores = []
    for seed in range(UNSEEN_SEED, UNSEEN_SEED + episodes):
        scores.append(score_episode(policy, env, seed))
        if progress is not None:
            progress(len(scores))
    return scores


def score_episode(policy: Policy, env: gym.Env[Any, Any], seed: int) -> EpisodeScore:
    """Run a policy on the episode of a seed, after its `reset()` if it has one."""
    if callable(reset := getattr(policy, "reset", None)):
        reset()
    observation, info = env.reset(seed=seed)
    total, steps, force, ended = 0.0, 0, 0.0, False
    while not ended:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        total, steps, ended = total + float(reward), steps + 1, terminated or truncated
        force = max(force, float(info["contact_force_n"]))
    return EpisodeScore(
        seed=seed,
        success=bool(info["is_success"]),
        terminated_by=info["terminated_by"],
        total_return=total,
        steps=steps,
        error_mm=float(info["target_error_mm"]),
        force_n=force,
    )


def summarised(scores: Sequence[EpisodeScore]) -> dict[str, Any]:
    """Return the rate of success with Wilson's 95 % interval, and means with the bootstrap's over seeds."""
    successes = sum(score.success for score in scores)
    means: dict[str, Any] = {}
    for name in _QUANTITIES:
        found = estimate([float(getattr(score, name)) for score in scores])
        means[name] = None if found is None else {"mean": found.mean, "low": found.low, "high": found.high}
    return {
        "episodes": len(scores),
        "success_rate": successes / len(scores),
        "success_interval_95": wilson_interval(successes, len(scores)),
        **means,
    }


def write_result(out: Path, training: Training, scores: Sequence[EpisodeScore]) -> dict[str, Any]:
    """Write `summary.json` into a folder: what was trained, on which machine, and how good it is; return that."""
    result = {
        **asdict(training),
        "versions": {name: version(name) for name in ("laploop", "torch", "gymnasium")},
        "machine": describe_machine(),
        "evaluation": summarised(scores),
        "rows": [asdict(score) for score in scores],
    }
    with whole_file(out / RESULT) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def verdict(result: Mapping[str, Any]) -> str:
    """Return in a line what `write_result` has returned."""
    found = result["evaluation"]
    low, high = found["success_interval_95"]
    return (
        f"{result['method']}: success {100 * found['success_rate']:.0f} % ({100 * low:.0f} to {100 * high:.0f}) of "
        f"{found['episodes']} unseen episodes, return {found['total_return']['mean']:.2f}"
    )


class Stopwatch:
    """Wall and CPU seconds since it was made."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    @property
    def wall_s(self) -> float:
        """Seconds by the clock on the wall."""
        return time.perf_counter() - self._wall

    @property
    def cpu_s(self) -> float:
        """Seconds of all threads of this process."""
        return time.process_time() - self._cpu
