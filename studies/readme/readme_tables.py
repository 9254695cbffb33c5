"""The README's short tables: one each of depth, loop, latency, speed and learning, with links to the whole."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from laploop.studies.episodes.task_table import quantity
from laploop.studies.readme.results_tables import overall
from laploop.studies.readme.summaries import read_summary

NETWORKS = ("compact", "ssle-phase")
"""Those that take any rig."""
_TOLD_MS = (0, 100, 500)
"""Latencies whose errors the table has."""


def summary_markdown(folder: Path) -> str:
    """Return the README's short tables for the summaries in `folder`: depth, loop, latency, speed, learning.

    Raises:
        MissingFileError: If the folder lacks one of them.
    """
    tables = {
        "Depth": ("results/README.md#depth-against-exact-truth", _depth_summary(folder)),
        "Loop": ("results/README.md#tasks", _loop_summary(folder)),
        "Latency": ("studies/latency.md", _latency_summary(folder)),
        "Speed": ("results/README.md#time-of-each-stage", _speed_summary(folder)),
        "Learning": ("baselines.md", _learning_summary(folder)),
    }
    parts = []
    for name, (page, rows) in tables.items():
        head = f"| [{name}](docs/{page}) | |"
        parts.append("\n".join([head, "|---|---|", *(f"| {what} | {result} |" for what, result in rows.items())]))
    return "\n\n".join(parts)


def _depth_summary(folder: Path) -> dict[str, str]:
    exact = overall(read_summary(folder / "robustness.json"), "exact")
    pairs = overall(read_summary(folder / "depth-pairs.json"), "zivid")
    rows = {
        f"`{model}`, held-out tissues, where valid": f"{row['valid_mae_mm']:.2f} mm on {100 * row['valid_share']:.0f} %"
        for model, row in exact.items()
        if model in NETWORKS or model == "phase"
    }
    return rows | {"`ssle`, the paper's protocol": f"{pairs['ssle']['mae_mm']:.2f} mm (paper, real bench: 3.70 mm)"}


def _loop_summary(folder: Path) -> dict[str, str]:
    reach = read_summary(folder / "trials-compact-breathing.json")
    lines = {line["campaign"]: line for line in read_summary(folder / "tasks.json")["campaigns"]}
    rows = {
        "reach, breathing tissue": f"{100 * reach['success_rate']:.0f} % of {reach['episodes']} episodes, "
        f"{reach['final_error_mm']['mean']:.2f} mm off, never above {reach['contact_force_n']['max']:.2f} N"
    }
    for campaign, check in (("palpate-still", "force over the last hold time"), ("scan-compact", "RMS of the stand-off")):
        if (line := lines.get(campaign)) is not None:
            rows[line["task"]] = f"{100 * line['success_rate']:.0f} % of {line['episodes']}, {check} {_checked(line, check)}"
    return rows


def _latency_summary(folder: Path) -> dict[str, str]:
    rows = {}
    error_mm = {
        line["condition"]: line["metrics"]["total_rms_mm"]["value"]["mean"]
        for line in read_summary(folder / "study-latency.json")["conditions"]
    }
    for name, what in (("none", "no prediction"), ("rhythms, patient", "predicted")):
        found = [f"{error_mm[f'latency: latency_ms={late}, prediction={name}, motion=breathing']:.2f}" for late in _TOLD_MS]
        rows[f"track, exact depth {'/'.join(map(str, _TOLD_MS))} ms late, {what}"] = f"{'/'.join(found)} mm RMS"
    lines = {line["campaign"]: line for line in read_summary(folder / "tasks.json")["campaigns"]}
    if (line := lines.get("track-compact")) is not None:
        rows["track, `compact` 100 ms late, predicted"] = f"{_checked(line, 'RMS error along the normal')} RMS"
    return rows


def _speed_summary(folder: Path) -> dict[str, str]:
    rows = {
        f"`{model}`, a frame, one core": f"{read_summary(path)['p50_ms']:.1f} ms"
        for model in NETWORKS
        if (path := folder / f"speed-{model}.json").is_file()
    }
    bench = read_summary(folder / "bench.json")
    steps = bench["env_steps_per_s"]
    return rows | {
        "whole loop, two cores": f"{bench['loop']['real_time_factor']['median']:.2f} of real time",
        "steps of 40 ms, states alone, `full` / `fast`": " / ".join(
            f"{steps[fidelity]['state']['single']:.0f} a second" for fidelity in ("full", "fast")
        ),
    }


def _learning_summary(folder: Path) -> dict[str, str]:
    runs = read_summary(folder / "baselines.json")["runs"].values()
    successes = [
        [one for run in runs if run["method"] == method for one in run["episodes"]["success"]]
        for method in ("ppo", "ppo, in full")
    ]
    rates = "/".join(f"{100 * sum(ones) / len(ones):.0f}" for ones in successes if ones)
    return {"PPO on states, reach in `fast`/`full`": f"{rates} % of {len(successes[0])} unseen episodes"}


def _checked(line: Mapping[str, Any], name: str) -> str:
    return quantity(next(check for check in line["checks"] if check["name"] == name))
