"""Many episodes, one a seed, and their totals."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.envs.episode_config import EpisodeConfig
from laploop.errors import InfeasibleError, InvalidValueError, SimulationError
from laploop.studies.code_digest import code_digest
from laploop.studies.csv_text import csv_text
from laploop.whole_file import whole_file
from laploop.workers import run_in_workers

Row = dict[str, Any]

ROWS_FOLDER = "rows"

COLUMNS = (
    "seed",
    "success",
    "terminated_by",
    "sim_s",
    "final_error_mm",
    "contact_force_n",
    "rcm_camera_mm",
    "rcm_tool_mm",
    "port_force_n",
    "depth_mae_mm",
    "depth_valid_fraction",
    "real_time_factor",
    "error",
)
"""Columns of every task's table; the task's own metrics and the arms' use of their limits follow."""


@configuration
class TrialsConfig:
    """Which episodes to run: `episode` as it is, and with each of the following seeds."""

    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    seeds: Annotated[int, Field(ge=1, le=100_000)] = 30
    """Number of episodes."""
    workers: Annotated[int, Field(ge=1, le=1024)] = 1
    """Processes that run episodes at the same time."""

    def episodes(self) -> tuple[EpisodeConfig, ...]:
        """Return the configuration of every episode."""
        return tuple(replace(self.episode, seed=self.episode.seed + number) for number in range(self.seeds))


def run_trials(
    config: TrialsConfig,
    out: Path,
    progress: Callable[[float], None] | None = None,
    run: Callable[[EpisodeConfig], Row] | None = None,
) -> list[Row]:
    """Run the episodes that have no row yet, and return the rows of all, in the order of their seeds.

    A finished episode's row is kept in `out/rows`. A row of the same configuration, content of its files, version and code of
    laploop is not run again (remove the folder to start over). An episode whose physics or control failed gives a row without
    success, and is tried again the next time.

    Args:
        config: What to run.
        out: An existing folder.
        progress: Called with the number of rows so far.
        run: Runs one episode, `run_trial` if not given; must be picklable with more than one worker.

    Raises:
        LaploopError: If something is wrong for every episode, such as missing weights.
        WorkerError: If the worker processes cannot be started, or one of them dies.
    """
    folder = out / ROWS_FOLDER
    key = episode_key(config.episode)
    rows = {episode.seed: row for episode in config.episodes() if (row := kept_row(folder, key, episode.seed)) is not None}
    missing = [episode for episode in config.episodes() if episode.seed not in rows]
    if progress is not None:
        progress(len(rows))

    def keep(episode: EpisodeConfig, row: Row) -> None:
        rows[episode.seed] = row
        keep_row(folder, key, row)
        if progress is not None:
            progress(len(rows))

    run_in_workers(run or run_trial, missing, config.workers, keep, prepare=partial(_share_cores, config.workers))
    return [rows[seed] for seed in sorted(rows)]


def run_trial(episode: EpisodeConfig) -> Row:
    """Run one episode and return its row; a failure of its physics or control becomes a row too."""
    from laploop.envs.episode import run_episode  # slow to import

    try:
        summary = run_episode(episode)
    except (SimulationError, InfeasibleError) as error:
        return failed_row(episode.seed, error)
    return row_of(episode.seed, summary)


def failed_row(seed: int, error: Exception) -> Row:
    """Return the row of an episode that could not be run to its end."""
    failed = {"seed": seed, "success": False, "terminated_by": "error", "error": str(error), "metrics": {}, "limits": {}}
    return {**dict.fromkeys(COLUMNS), **failed}


def row_of(seed: int, summary: Mapping[str, Any]) -> Row:
    """Flatten an episode's summary into a row."""
    return {
        "seed": seed,
        "success": bool(summary["success"]),
        "terminated_by": summary["terminated_by"],
        "sim_s": summary["sim_s"],
        "final_error_mm": summary["target_error_mm"]["final"],
        "contact_force_n": summary["contact_force_n"]["max"],
        "rcm_camera_mm": summary["rcm_error_mm"]["camera_max"],
        "rcm_tool_mm": summary["rcm_error_mm"]["tool_max"],
        "port_force_n": max(summary["port_force_n"].values()),
        "depth_mae_mm": summary["depth_mae_mm"],
        "depth_valid_fraction": summary["depth_valid_fraction"],
        "real_time_factor": summary["real_time_factor"],
        "error": None,
        "metrics": dict(summary.get("metrics", {})),
        "limits": dict(summary.get("limits", {})),
    }


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Return totals: the success rate with its 95 % interval (Wilson's), final errors of all that ended, worst values."""
    errors = _column(rows, "final_error_mm")
    successes = sum(bool(row["success"]) for row in rows)
    return {
        "episodes": len(rows),
        "success_rate": successes / len(rows),
        "success_interval_95": wilson_interval(successes, len(rows)),
        "terminated_by": dict(Counter(str(row["terminated_by"]) for row in rows)),
        "final_error_mm": {
            "mean": float(np.mean(errors)) if errors.size else None,
            "median": float(np.median(errors)) if errors.size else None,
            "p95": float(np.percentile(errors, 95)) if errors.size else None,
            "max": _worst(rows, "final_error_mm"),
        },
        "contact_force_n": {"max": _worst(rows, "contact_force_n")},
        "rcm_error_mm": {"camera_max": _worst(rows, "rcm_camera_mm"), "tool_max": _worst(rows, "rcm_tool_mm")},
        "port_force_n": {"max": _worst(rows, "port_force_n")},
        "depth_mae_mm": float(np.mean(depth)) if (depth := _column(rows, "depth_mae_mm")).size else None,
        "metrics": _spreads(rows, "metrics"),
        "limits": _spreads(rows, "limits"),
        "rows": list(rows),
    }


def _names(rows: Sequence[Row], *groups: str) -> tuple[str, ...]:
    """Return the names in some groups of the rows, `metrics` or `limits`, in the order of their first appearance."""
    return tuple(dict.fromkeys(name for group in groups for row in rows for name in row.get(group, {})))


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate by Wilson's score (J Am Stat Assoc 1927;22:209)."""
    from scipy.stats import binomtest  # slow to import

    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def as_csv(rows: Sequence[Row]) -> str:
    """Write rows as CSV."""
    columns = (*COLUMNS, *_names(rows, "metrics", "limits"))
    return csv_text(columns, ([flat.get(name) for name in columns] for flat in map(_flat, rows)))


def as_markdown(rows: Sequence[Row], summary: Mapping[str, Any]) -> str:
    """Write the totals and the rows as Markdown."""
    low, high = summary["success_interval_95"]
    error = summary["final_error_mm"]
    lines = [
        f"{summary['episodes']} episodes.",
        f"Success {100 * summary['success_rate']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %).",
        f"Final target error in mm: mean {_cell(error['mean'])}, median {_cell(error['median'])},",
        f"95th percentile {_cell(error['p95'])}, worst {_cell(error['max'])}.",
        "",
    ]
    metrics = {**summary["metrics"], **summary["limits"]}
    if metrics:
        lines += ["| metric | mean | min | max |", "|---|---|---|---|"]
        for name, one in metrics.items():
            lines.append(f"| {name} | {_cell(one['mean'])} | {_cell(one['min'])} | {_cell(one['max'])} |")
        lines.append("")
    columns = (*COLUMNS, *_names(rows, "metrics", "limits"))
    lines += ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(_cell(_flat(row).get(name)) for name in columns) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3g}" if isinstance(value, float) else str(value).replace("|", "\\|")


def _flat(row: Row) -> Row:
    return {**{name: row[name] for name in COLUMNS}, **row.get("metrics", {}), **row.get("limits", {})}


def _spreads(rows: Sequence[Row], group: str) -> dict[str, dict[str, float | None]]:
    return {name: _spread([row.get(group, {}).get(name) for row in rows]) for name in _names(rows, group)}


def _spread(values: Sequence[float | None]) -> dict[str, float | None]:
    """Return mean, minimum and maximum of what was measured."""
    known = [value for value in values if value is not None]
    if not known:
        return {"mean": None, "min": None, "max": None}
    return {"mean": float(np.mean(known)), "min": min(known), "max": max(known)}


def _column(rows: Sequence[Row], name: str) -> NDArray[np.float64]:
    return np.array([row[name] for row in rows if row[name] is not None], dtype=np.float64)


def _worst(rows: Sequence[Row], name: str) -> float | None:
    values = _column(rows, name)
    return float(values.max()) if values.size else None


def _share_cores(workers: int) -> None:
    import torch  # slow to import

    torch.set_num_threads(max(1, (os.cpu_count() or 1) // workers))


def episode_key(episode: EpisodeConfig) -> str:
    """Return a hash of all that decides an episode's row, apart from its seed: a file counts by its content."""
    decisive = {**asdict(episode), "seed": None, "version": version("laploop"), "code": code_digest("episodes")}
    return hashlib.sha256(json.dumps(decisive, default=_digest, sort_keys=True).encode()).hexdigest()


def _digest(value: object) -> str:
    if isinstance(value, Path) and value.is_file():
        with value.open("rb") as stream:
            return f"sha256:{hashlib.file_digest(stream, 'sha256').hexdigest()}"
    return str(value)


def _row_path(folder: Path, seed: int) -> Path:
    return folder / f"seed_{seed:06d}.json"


def kept_row(folder: Path, key: str, seed: int) -> Row | None:
    """Return the row that a seed has in a folder; None if there is none, it failed, or its key is another.

    Raises:
        InvalidValueError: If the file is damaged.
    """
    path = _row_path(folder, seed)
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
        row: Row = kept["row"]
        same = row["seed"] == seed and row["error"] is None and kept.get("key") == key
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InvalidValueError("kept row", str(path), "JSON as this command wrote it; remove the file") from error
    return row if same else None


def keep_row(folder: Path, key: str, row: Row) -> None:
    """Write a row into a folder, whole or not at all."""
    with whole_file(_row_path(folder, row["seed"])) as path:
        path.write_text(json.dumps({"key": key, "row": row}, indent=1) + "\n", encoding="utf-8")
