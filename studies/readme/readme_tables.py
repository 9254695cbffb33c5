"""The README's short tables: one each of depth, loop, latency and speed, with links to the whole."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from laploop.studies.episodes.task_table import quantity
from laploop.studies.readme.results_tables import overall
from laploop.studies.readme.summaries import read_summary

NETWORKS = ("compact", "ssle-phase")
"""Those that take any rig."""


def summary_markdown(folder: Path) -> str:
    """Return the README's short tables for the summaries in `folder`: depth, loop, latency, speed.

    Raises:
        MissingFileError: If the folder lacks one of them.
    """
    tables = {
        "Depth": ("depth-against-exact-truth", _depth_summary(folder)),
        "Loop": ("tasks", _loop_summary(folder)),
        "Latency": ("tasks", _latency_summary(folder)),
        "Speed": ("time-of-each-stage", _speed_summary(folder)),
    }
    parts = []
    for name, (anchor, rows) in tables.items():
        head = f"| [{name}](docs/results/README.md#{anchor}) | |"
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
    if (line := lines.get("look")) is not None:
        rows["look"] = f"{100 * line['success_rate']:.0f} % of {line['episodes']}"
    return rows


def _latency_summary(folder: Path) -> dict[str, str]:
    lines = {line["campaign"]: line for line in read_summary(folder / "tasks.json")["campaigns"]}
    names = {
        "track-oracle-unpredicted": "track, exact depth, no prediction",
        "track-oracle": "track, exact depth, prediction",
        "track-compact": "track, `compact`, prediction",
    }
    return {
        f"{what}, 100 ms late": f"{_checked(lines[campaign], 'RMS error along the normal')} RMS"
        for campaign, what in names.items()
        if campaign in lines
    }


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


def _checked(line: Mapping[str, Any], name: str) -> str:
    return quantity(next(check for check in line["checks"] if check["name"] == name))
