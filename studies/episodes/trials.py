"""Many episodes, one a seed, and what they add up to."""

import csv
import io
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.envs.episode_config import EpisodeConfig
from laploop.errors import InfeasibleError, InvalidValueError, OutputError, SimulationError
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
"""Columns of every task's table; behind them come the task's own metrics and what the arms' limits were used to."""


@dataclass(frozen=True, kw_only=True)
class TrialsConfig:
    """Which episodes to run: `episode` as it is, and with each of the following seeds."""

    episode: EpisodeConfig = field(default_factory=EpisodeConfig)
    seeds: int = 30
    """How many episodes."""
    workers: int = 1
    """Processes that run episodes at the same time."""

    def __post_init__(self) -> None:
        """Check the counts.

        Raises:
            InvalidValueError: If one is out of range.
        """
        for name, least, most in (("seeds", 1, 100_000), ("workers", 1, 1024)):
            if not least <= getattr(self, name) <= most:
                raise InvalidValueError(name, getattr(self, name), f"{least} to {most}")

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

    A finished episode's row is kept in `out/rows`; one that is there for the same configuration and version of laploop is
    not run again (remove the folder to start over). An episode whose physics or control failed gives a row without success,
    and is tried again the next time.

    Args:
        config: What to run.
        out: An existing folder.
        progress: Called with the number of rows that are there.
        run: Runs one episode, `run_trial` if not given; must be picklable with more than one worker.

    Raises:
        LaploopError: If something is wrong that every episode would meet, as missing weights.
        WorkerError: If the worker processes cannot be started, or one of them dies.
    """
    folder = out / ROWS_FOLDER
    rows = {episode.seed: row for episode in config.episodes() if (row := _kept_row(folder, episode)) is not None}
    missing = [episode for episode in config.episodes() if episode.seed not in rows]
    if progress is not None:
        progress(len(rows))

    def keep(episode: EpisodeConfig, row: Row) -> None:
        rows[episode.seed] = row
        _keep_row(folder, episode, row)
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
        failed = {
            "seed": episode.seed,
            "success": False,
            "terminated_by": "error",
            "error": str(error),
            "metrics": {},
            "limits": {},
        }
        return {**dict.fromkeys(COLUMNS), **failed}
    return row_of(episode.seed, summary)


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
    """Add rows up: the success rate with its 95 % interval (Wilson's), final errors of all that ended, worst values."""
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
    """Return the names in groups of the rows, `metrics` or `limits`, in the order of their first appearance."""
    return tuple(dict.fromkeys(name for group in groups for row in rows for name in row.get(group, {})))


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate by Wilson's score (J Am Stat Assoc 1927;22:209)."""
    z = 1.959963985
    rate = successes / trials
    middle = (rate + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * math.sqrt(rate * (1 - rate) / trials + z * z / (4 * trials * trials)) / (1 + z * z / trials)
    return max(0.0, middle - half), min(1.0, middle + half)


def as_csv(rows: Sequence[Row]) -> str:
    """Write rows as CSV."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=(*COLUMNS, *_names(rows, "metrics", "limits")), lineterminator="\n")
    writer.writeheader()
    writer.writerows(_flat(row) for row in rows)
    return text.getvalue()


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
        lines += ["| metric | mean | least | greatest |", "|---|---|---|---|"]
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
    """Return mean, least and greatest of what was measured."""
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


def _plain(episode: EpisodeConfig) -> dict[str, Any]:
    """Return the configuration as JSON would give it back."""
    plain: dict[str, Any] = json.loads(json.dumps(asdict(episode), default=str))
    return plain


def _row_path(folder: Path, episode: EpisodeConfig) -> Path:
    return folder / f"seed_{episode.seed:06d}.json"


def _kept_row(folder: Path, episode: EpisodeConfig) -> Row | None:
    path = _row_path(folder, episode)
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise InvalidValueError("kept row", str(path), "JSON as this command wrote it; remove the file") from error
    same = kept["version"] == version("laploop") and kept["episode"] == _plain(episode)
    row: Row = kept["row"]
    return row if same and row["error"] is None else None


def _keep_row(folder: Path, episode: EpisodeConfig, row: Row) -> None:
    path = _row_path(folder, episode)
    partial = path.with_suffix(".partial")
    kept = {"version": version("laploop"), "episode": _plain(episode), "row": row}
    try:
        folder.mkdir(exist_ok=True)
        partial.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
