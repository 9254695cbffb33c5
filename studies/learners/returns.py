"""Returns that learners can compare theirs with: of doing nothing, of chance, and of the scripted controllers.

`python -P -m laploop.studies.learners.returns docs/results/learner-returns.json reach track` measures these tasks and leaves
what the file has of others.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import gymnasium as gym
import numpy as np

from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.tasks.registry import TASKS, environment_id
from laploop.studies.demonstrations.expert import Expert
from laploop.studies.learners.evaluation import EpisodeScore, Policy, score_episode
from laploop.studies.sweeps.bootstrap import estimate
from laploop.whole_file import whole_file

PolicyName = Literal["zero", "random", "scripted"]
SEEDS = 10
"""Episodes of each policy."""
CONDITIONS: dict[str, Any] = {"perception": "oracle", "fidelity": "fast"}
"""Keywords of the environments; all else is as it is by default."""


def measure_returns(task: str, seeds: int = SEEDS) -> dict[str, Any]:
    """Return, for each policy, the dense returns of its episodes, their mean, the steps, and the rate of success.

    `scripted` asks the task's controller once a step and holds its command, as a learner's policy would be.

    Raises:
        UnknownNameError: If there is no such task.
    """
    return {policy: _summary([_episode(task, policy, seed) for seed in range(seeds)]) for policy in get_args(PolicyName)}


def _episode(task: str, name: PolicyName, seed: int) -> EpisodeScore:
    env = gym.make(environment_id(task, 1), **CONDITIONS)
    try:
        learner = env.unwrapped
        if not isinstance(learner, LearnerEnv):
            raise TypeError(f"{environment_id(task, 1)} is a {type(learner).__name__}")
        env.action_space.seed(seed)
        return score_episode(_policy(name, learner), env, seed)
    finally:
        env.close()


def _policy(name: PolicyName, env: LearnerEnv) -> Policy:
    if name == "random":
        return lambda _: env.action_space.sample()
    if name == "zero":
        return lambda _: np.zeros(3, np.float32)
    expert = Expert(env)
    return lambda _: expert.action()


def _summary(episodes: Sequence[EpisodeScore]) -> dict[str, Any]:
    return {
        "mean_return": float(np.mean([one.total_return for one in episodes])),
        "returns": [one.total_return for one in episodes],
        "steps": [one.steps for one in episodes],
        "success_rate": float(np.mean([one.success for one in episodes])),
    }


def returns_table(tasks: dict[str, Any]) -> str:
    """Return the measured tasks as a Markdown table: mean returns with the bootstrap's 95 % interval over seeds."""
    lines = ["| task | zero | random | scripted | scripted, success |", "|---|---|---|---|---|"]
    for task, row in tasks.items():
        means = [_with_interval(row[policy]["returns"]) for policy in get_args(PolicyName)]
        lines.append(f"| {task} | {' | '.join(means)} | {100 * row['scripted']['success_rate']:.0f} % |")
    return "\n".join(lines)


def _with_interval(returns: Sequence[float]) -> str:
    found = estimate(returns)
    return "" if found is None else f"{found.mean:.2f} ({found.low:.2f} to {found.high:.2f})"


def main(arguments: Sequence[str]) -> None:
    """Measure tasks, by default all of them, and write them to a file: `arguments` are its path and their names."""
    path, tasks = Path(arguments[0]), arguments[1:] or TASKS.names()
    measured = json.loads(path.read_text(encoding="utf-8"))["tasks"] if path.is_file() else {}
    for task in tasks:
        measured[task] = measure_returns(task)
    ordered = {task: measured[task] for task in TASKS.names() if task in measured}
    result = {"seeds": SEEDS, "conditions": CONDITIONS, "reward": "dense", "tasks": ordered}
    with whole_file(path) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
