"""Runs a sweep: every episode once, each row on disk as soon as it is there."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from laploop.envs.episode_config import EpisodeConfig
from laploop.errors import WorkerError
from laploop.studies.episodes.trials import ROWS_FOLDER, Row, episode_key, failed_row, keep_row, kept_row
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.episode import run_study_episode
from laploop.studies.sweeps.process_team import run_in_team
from laploop.studies.sweeps.ray_team import run_on_ray
from laploop.studies.sweeps.sweep import Condition, Sweep

_FOLDER_DIGITS = 16

SweepRow = dict[str, Any]
"""An episode's row with its `condition`, `group` and the label of each axis."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One condition and the rows of its episodes."""

    condition: Condition
    rows: tuple[Row, ...]
    """In the order of their seeds."""

    def values(self, metric: str) -> list[float | None]:
        """Return a metric of every episode, None where it was not measured."""
        return [measured(row, metric) for row in self.rows]


def run_sweep(
    sweep: Sweep,
    out: Path,
    engine: Engine,
    progress: Callable[[float], None] | None = None,
    run: Callable[[EpisodeConfig], Row] = run_study_episode,
) -> list[Outcome]:
    """Run the episodes that have no row yet, and return the rows of all conditions, in the sweep's order.

    A finished episode's row is kept in `out/rows`, by all that decides it: configuration, content of files, code of laploop.
    Conditions that share an episode share its row. An episode that failed, or whose worker died twice, gives a row with an
    error, and is tried again the next time.

    Args:
        sweep: What to run.
        out: An existing folder.
        engine: Where.
        progress: Called with the number of rows so far.
        run: Runs one episode; picklable with more than one worker.

    Raises:
        LaploopError: If something is wrong for every episode, or the workers cannot be started.
    """
    plans = [(condition, _folder(out, condition), condition.episodes(sweep.seeds)) for condition in sweep.conditions]
    places = {(folder, one.seed): one for _, folder, episodes in plans for one in episodes}
    rows: dict[tuple[Path, int], Row] = {}
    for folder, seed in places:
        if (row := kept_row(folder, folder.name, seed)) is not None:
            rows[folder, seed] = row
    missing = [_Job(place=place, episode=episode, run=run) for place, episode in places.items() if place not in rows]
    shared = [(folder, one.seed) for _, folder, episodes in plans for one in episodes]

    def report() -> None:
        if progress is not None:
            progress(sum(place in rows for place in shared))

    def done(job: _Job, row: Row) -> None:
        folder, _ = job.place
        keep_row(folder, folder.name, row)
        rows[job.place] = row
        report()

    def died(job: _Job, reason: str) -> None:
        rows[job.place] = failed_row(job.episode.seed, WorkerError(reason))
        report()

    report()
    if missing and engine.engine == "ray":
        run_on_ray(_do, missing, engine.workers, done, died, address=engine.address)
    elif missing:
        run_in_team(_do, missing, min(engine.workers, max(2, len(missing))), done, died)
    return [
        Outcome(condition=condition, rows=tuple(rows[folder, one.seed] for one in episodes))
        for condition, folder, episodes in plans
    ]


def measured(row: Row, metric: str) -> float | None:
    """Return a number of a row, None if it was not measured."""
    value = {**row, **row.get("limits", {}), **row.get("metrics", {})}.get(metric)
    return None if value is None else float(value)


def flat_rows(outcomes: Sequence[Outcome]) -> list[SweepRow]:
    """Return one flat row an episode; all have the same columns."""
    flat = []
    for outcome in outcomes:
        condition = outcome.condition
        for row in outcome.rows:
            own = {name: value for name, value in row.items() if name not in {"metrics", "limits", "real_time_factor"}}
            named = {"condition": condition.name, "group": condition.group, **condition.values}
            flat.append({**named, **own, **row.get("limits", {}), **row.get("metrics", {})})
    columns = dict.fromkeys(name for row in flat for name in row)
    return [{**dict.fromkeys(columns), **row} for row in flat]


def write_parquet(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write one row an episode; an axis of different kinds of values becomes text."""
    import pyarrow as pa  # slow to import
    from pyarrow import parquet

    rows = flat_rows(outcomes)
    columns = {name: _of_one_kind([row[name] for row in rows]) for name in (rows[0] if rows else ())}
    parquet.write_table(pa.table(columns), path)


def _of_one_kind(values: list[Any]) -> list[Any]:
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and len(kinds) == 2:
        return [None if value is None else float(value) for value in values]
    return values if len(kinds) <= 1 else [None if value is None else str(value) for value in values]


@dataclass(frozen=True, kw_only=True)
class _Job:
    place: tuple[Path, int]
    episode: EpisodeConfig
    run: Callable[[EpisodeConfig], Row]


def _do(job: _Job) -> Row:
    return job.run(job.episode)


def _folder(out: Path, condition: Condition) -> Path:
    return out / ROWS_FOLDER / episode_key(condition.episode)[:_FOLDER_DIGITS]
