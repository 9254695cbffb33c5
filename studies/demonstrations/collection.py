"""Runs the episodes of a data set: each seed once, each episode on disk as soon as it is there."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from laploop.errors import InfeasibleError, SimulationError
from laploop.studies.demonstrations.config import CollectionConfig, DemonstrationConfig
from laploop.studies.demonstrations.demonstration import demonstrate, one_thread
from laploop.studies.demonstrations.episode_folder import EpisodeFolder
from laploop.workers import run_in_workers

EPISODES_FOLDER = "episodes"

Outcome = dict[str, Any]

_MOST_TRIED = 5
"""Seeds that are tried for each episode wanted, before a collection ends with fewer."""


@dataclass(frozen=True, kw_only=True)
class Collection:
    """What was collected."""

    kept: tuple[Outcome, ...]
    """Of the episodes of the data set, in the order of their seeds."""
    dropped: tuple[Outcome, ...]
    """Of the other seeds that were tried; with `error` where the episode could not be run."""


def collect(
    config: DemonstrationConfig, collection: CollectionConfig, out: Path, progress: Callable[[float], None] | None = None
) -> Collection:
    """Run the episodes that are not on disk yet, until there are as many as wanted.

    Finished episodes are in `out/episodes`; those of the same configuration and the same code of laploop are not run again.
    The seeds that are tried do not depend on the number of workers: as many as are still wanted, again and again.

    Args:
        config: What is demonstrated.
        collection: How many episodes.
        out: An existing folder.
        progress: Called with the number of episodes kept so far.

    Raises:
        LaploopError: If something is wrong for every episode.
        WorkerError: If the worker processes cannot be started, or one of them dies.
    """
    key = config.key
    folder = EpisodeFolder(out / EPISODES_FOLDER, key)
    outcomes: dict[int, Outcome] = {}
    end = collection.seed

    def counts(outcome: Outcome) -> bool:
        return "error" not in outcome and (collection.keep == "all" or outcome["success"])

    def done(job: _Job, outcome: Outcome) -> None:
        outcomes[job.seed] = outcome
        if progress is not None:
            progress(sum(map(counts, outcomes.values())))

    while True:
        wanted = collection.episodes - sum(map(counts, outcomes.values()))
        wanted = min(wanted, collection.seed + _MOST_TRIED * collection.episodes - end)
        if wanted <= 0:
            break
        jobs = [_Job(config=config, path=folder.path, key=key, seed=seed) for seed in range(end, end + wanted)]
        end += wanted
        missing = []
        for job in jobs:
            if (outcome := folder.outcome(job.seed)) is None:
                missing.append(job)
            else:
                done(job, outcome)
        run_in_workers(_run, missing, collection.workers, done, prepare=one_thread)
    ordered = [outcomes[seed] for seed in sorted(outcomes)]
    return Collection(
        kept=tuple(one for one in ordered if counts(one)), dropped=tuple(one for one in ordered if not counts(one))
    )


@dataclass(frozen=True, kw_only=True)
class _Job:
    config: DemonstrationConfig
    path: Path
    key: str
    """Made once, before the first episode: code that is changed meanwhile is not what a worker has loaded."""
    seed: int


def _run(job: _Job) -> Outcome:
    try:
        demonstration = demonstrate(job.config, job.seed)
    except (SimulationError, InfeasibleError) as error:
        return {"seed": job.seed, "success": False, "error": str(error)}
    EpisodeFolder(job.path, job.key).save(demonstration)
    return demonstration.outcome
