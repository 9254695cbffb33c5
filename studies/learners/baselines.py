"""The table of learners: what the examples reach, over seeds, on episodes that no training saw.

`python -P -m laploop.studies.learners.baselines examples/learning runs/baselines docs/results/baselines.json ppo sac` trains
with these methods, by default with all, and leaves what the file has of others. A run that has a summary is not done again.
"""

import json
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from laploop.errors import UnknownNameError, WorkerError
from laploop.studies.episodes.trials import wilson_interval
from laploop.studies.learners.curve import CURVE, read_curve
from laploop.studies.learners.evaluation import RESULT, Training, evaluate, write_result
from laploop.studies.sweeps.bootstrap import Estimate, nested_estimate
from laploop.whole_file import whole_file

SEEDS = 3
"""Trainings of each method."""
_POINTS = 40
"""Of a curve in the table: each the mean of a part of the training."""
_KEPT = ("method", "environment", "keywords", "seed", "steps", "wall_s", "cpu_s", "versions", "machine", "evaluation")
_ROWS = ("success", "total_return", "error_mm", "force_n")
_HEADS = (
    "task",
    "method",
    "steps",
    "seeds x episodes",
    "success (95 %), each training",
    "return",
    "error at the end",
    "worst force, mean",
    "training, CPU / wall",
)


@dataclass(frozen=True, kw_only=True)
class Method:
    """An example and what it is called with."""

    script: str
    arguments: tuple[str, ...] = ()
    tried_in_full: bool = False
    """Whether its policy, which learns in `fast`, is evaluated in `full` as well; one of stable-baselines3 it must be."""


METHODS: Mapping[str, Method] = {
    "ppo": Method(script="ppo.py", tried_in_full=True),
    "sac": Method(script="sac.py", tried_in_full=True),
    "tqc": Method(script="tqc.py", tried_in_full=True),
    "cloning": Method(script="behaviour_cloning.py"),
    "residual": Method(script="residual_rl.py"),
    "naive": Method(script="delayed_ppo.py", arguments=("--treatment", "naive")),
    "augmented": Method(script="delayed_ppo.py", arguments=("--treatment", "augmented")),
    "conservative": Method(script="delayed_ppo.py", arguments=("--treatment", "conservative")),
}
"""By the name of their folder. RLlib's PPO is that of stable-baselines3, and has no line of its own."""


def train(name: str, examples: Path, runs: Path, seeds: Iterable[int] = range(SEEDS)) -> None:
    """Train and evaluate with a method, once a seed, into `runs/NAME-SEED`, unless that is done.

    Raises:
        UnknownNameError: If there is no such method.
        WorkerError: If a training fails.
    """
    if name not in METHODS:
        raise UnknownNameError("method", name, list(METHODS))
    method = METHODS[name]
    for seed in seeds:
        out = runs / f"{name}-{seed}"
        if not (out / RESULT).is_file():
            command = [sys.executable, "-P", str(examples / method.script), *method.arguments]
            done = subprocess.run([*command, "--seed", str(seed), "--out", str(out)], check=False)  # noqa: S603  our own scripts
            if done.returncode:
                raise WorkerError(f"{' '.join(command)} has failed with the exit status {done.returncode}")
        if method.tried_in_full and not (out / "full" / RESULT).is_file():
            try_in_full(out)


def try_in_full(folder: Path) -> None:
    """Evaluate a policy of stable-baselines3 in the fidelity `full`, on the seeds of its evaluation, into `FOLDER/full`."""
    from laploop.studies.learners.sb3_policy import load_sb3  # an extra, which the table does without

    result = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    keywords = {**result["keywords"], "fidelity": "full"}
    env = gym.make(f"laploop:{result['environment']}", **keywords)
    policy = load_sb3(folder, env)
    scores = evaluate(lambda seen: policy.predict(seen, deterministic=True)[0], env, result["evaluation"]["episodes"])
    env.close()
    untrained = Training(
        method=f"{result['method']}, in full",
        environment=result["environment"],
        keywords=keywords,
        seed=result["seed"],
        steps=0,
        wall_s=0.0,
        cpu_s=0.0,
    )
    (folder / "full").mkdir(exist_ok=True)
    write_result(folder / "full", untrained, scores)


def collected(runs: Path) -> dict[str, Any]:
    """Return the runs below a folder, by the path of their own folder: what was trained, how it went, what came of it."""
    found: dict[str, Any] = {}
    for path in sorted(runs.rglob(RESULT)):
        result = json.loads(path.read_text(encoding="utf-8"))
        run = {key: result[key] for key in _KEPT}
        run["episodes"] = {key: [row[key] for row in result["rows"]] for key in _ROWS}
        run["curve"] = thinned(path.parent) if (path.parent / CURVE).is_file() else None
        found[path.parent.relative_to(runs).as_posix()] = run
    return found


def thinned(folder: Path) -> dict[str, list[float | None]]:
    """Return the curve in a folder in parts of equal numbers of steps: their ends, and the means in them or None."""
    curve = read_curve(folder)
    if not curve["steps"].size:
        return {name: [] for name in curve}
    edges = np.linspace(0.0, curve["steps"][-1], _POINTS + 1)
    part = np.clip(np.digitize(curve["steps"], edges, right=True) - 1, 0, _POINTS - 1)
    parts: dict[str, list[float | None]] = {"steps": [float(edge) for edge in edges[1:]]}
    for name in ("total_return", "length", "success", "cpu_s"):
        inside = [curve[name][part == number] for number in range(_POINTS)]
        means = [float(np.mean(values)) if values.size else float("nan") for values in inside]
        parts[name] = [mean if np.isfinite(mean) else None for mean in means]
    return parts


def baselines_table(runs: Mapping[str, Any]) -> str:
    """Return the runs as a Markdown table, a line for each task and method.

    The interval of a mean is the bootstrap's over trainings and their episodes. That of the success is the wider of this one,
    which is empty where all succeed, and of Wilson's over all episodes, which takes them for independent.
    """
    lines = [
        f"| {' | '.join(_HEADS)} |",
        "|" + "---|" * len(_HEADS),
    ]
    groups: dict[tuple[str, str], dict[int, Any]] = {}
    for run in runs.values():
        # What does not learn is the same beside every training.
        groups.setdefault((run["environment"], run["method"]), {}).setdefault(run["seed"], run)
    for (environment, method), by_seed in sorted(groups.items()):
        group = list(by_seed.values())
        each = [run["episodes"]["success"] for run in group]
        successes, trials = sum(map(sum, each)), sum(map(len, each))
        low, high = _widest(wilson_interval(successes, trials), nested_estimate(each) if len(each) > 1 else None)
        cpu_s, wall_s = (float(np.mean([run[key] for run in group])) for key in ("cpu_s", "wall_s"))
        cells = [
            environment.rpartition("/")[2],
            method,
            f"{group[0]['steps']:,}".replace(",", " ") if group[0]["steps"] else "",
            f"{len(group)} x {trials // len(group)}",
            f"{100 * successes / trials:.0f} % ({100 * low:.0f}-{100 * high:.0f}): "
            + ", ".join(f"{100 * np.mean(one):.0f}" for one in each),
            _mean(_pooled(group, "total_return")),
            f"{_mean(_pooled(group, 'error_mm'))} mm",
            f"{_mean(_pooled(group, 'force_n'))} N",
            f"{_time(cpu_s)} / {_time(wall_s)}" if cpu_s else "",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 60.0 else f"{seconds / 60.0:.0f} min"


def _widest(wilson: tuple[float, float], found: Estimate | None) -> tuple[float, float]:
    return wilson if found is None else (min(wilson[0], found.low), max(wilson[1], found.high))


def _pooled(group: Sequence[Mapping[str, Any]], key: str) -> Estimate | None:
    return nested_estimate([run["episodes"][key] for run in group])


def _mean(found: Estimate | None) -> str:
    return "" if found is None else f"{found.mean:.2f} ({found.low:.2f} to {found.high:.2f})"


def main(arguments: Sequence[str]) -> None:
    """Train, and write the table: `arguments` are the examples, the folder of the runs, the file, and names of methods."""
    examples, runs, path = (Path(argument) for argument in arguments[:3])
    for name in arguments[3:] or METHODS:
        train(name, examples, runs)
    known = json.loads(path.read_text(encoding="utf-8"))["runs"] if path.is_file() else {}
    merged = {**known, **collected(runs)}
    with whole_file(path) as partial:
        partial.write_text(json.dumps({"runs": dict(sorted(merged.items()))}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
