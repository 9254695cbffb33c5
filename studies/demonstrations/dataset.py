"""From a task to a data set of demonstrations, in one of the formats."""

import shutil
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np

from laploop.errors import InvalidValueError, SimulationError
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.collection import EPISODES_FOLDER, Collection, CollectionConfig, collect
from laploop.studies.demonstrations.config import DemonstrationConfig
from laploop.studies.demonstrations.demonstration import make_learner
from laploop.studies.demonstrations.episode_folder import EpisodeFolder
from laploop.studies.demonstrations.expert import Expert
from laploop.studies.demonstrations.lerobot_writer import frames_per_second, write_lerobot
from laploop.studies.demonstrations.minari_format import dataset_id, write_minari

FormatName = Literal["minari", "lerobot"]

_PARTIAL = ".dataset.partial"


def make_dataset(
    config: DemonstrationConfig,
    collection: CollectionConfig,
    format_name: FormatName,
    out: Path,
    progress: Callable[[float], None] | None = None,
) -> tuple[Path, Collection]:
    """Collect episodes, and write them as a data set that appears whole or not at all.

    Args:
        config: What is demonstrated.
        collection: How many episodes.
        format_name: `minari`, in the folder `out/minari/laploop/TASK-v0`, or `lerobot`, in `out/lerobot`.
        out: An existing folder.
        progress: Called with the number of episodes kept so far.

    Returns:
        The folder of the data set, and what became of the episodes.

    Raises:
        LaploopError: If something is not allowed, or wrong for every episode.
        SimulationError: If no episode can be kept.
        WorkerError: If the worker processes cannot be started, or one of them dies.
    """
    if format_name == "minari" and find_spec("minari") is None:
        raise InvalidValueError("format", format_name, "lerobot, or minari with the extra: pip install 'laploop[learning]'")
    env, learner = make_learner(config)
    try:
        card = Card.of(config, collection.keep, learner, Expert(learner).parameters)
        if format_name == "lerobot":
            frames_per_second(card)
        collected = collect(config, collection, out, progress)
        if not collected.kept:
            raise SimulationError(
                f"the expert succeeded in none of {len(collected.dropped)} episodes; keep all, or change the task"
            )
        folder = EpisodeFolder(out / EPISODES_FOLDER, config.key)
        demonstrations = (folder.load(outcome["seed"]) for outcome in collected.kept)
        partial = out / _PARTIAL
        shutil.rmtree(partial, ignore_errors=True)
        inner = partial / "data" if format_name == "minari" else partial
        inner.mkdir(parents=True)
        if format_name == "minari":
            write_minari(inner, card, env, demonstrations)
        else:
            write_lerobot(inner, card, demonstrations)
    finally:
        env.close()
    # Minari lists what lies in a folder of its own alone.
    target = out / "minari" / dataset_id(config.task) if format_name == "minari" else out / "lerobot"
    shutil.rmtree(target, ignore_errors=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    partial.replace(target)
    return target, collected


def summarise(collected: Collection, wanted: int) -> dict[str, Any]:
    """Return the totals of a collection; the rate of success is that of all seeds that were tried."""
    tried = [*collected.kept, *collected.dropped]
    return {
        "episodes": len(collected.kept),
        "wanted": wanted,
        "tried": len(tried),
        "success_rate": float(np.mean([one["success"] for one in tried])),
        "decisions": sum(one["decisions"] for one in collected.kept),
        "return_mean": float(np.mean([one["return"] for one in collected.kept])),
        "pushes": sum(len(one["pushes"]) for one in collected.kept),
        "failed": [one for one in collected.dropped if "error" in one],
        "outcomes": list(collected.kept),
    }
