"""`laploop demonstrate`: a data set of episodes by the scripted controllers, to learn from."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.envs.learning.options import LearnerOptions
from laploop.envs.randomisation.files import randomisation_of
from laploop.studies.demonstrations.config import CollectionConfig, DemonstrationConfig, Perturbation


@dataclass(frozen=True, kw_only=True)
class DemonstrateArguments:
    """Let the scripted controller of a task show how it is done, led off its path now and then, and keep what a learner needs.

    Writes a data set, to `DIR/minari/laploop/TASK-v0` or `DIR/lerobot`, and `summary.json`. Finished episodes are kept in
    `DIR/episodes`: the same command and code resume where they were stopped, and take them for another format or more episodes;
    remove that folder when it is done. The exit status is 1 if fewer episodes succeeded than were wanted.
    """

    task: str = "reach"
    """What to do: reach, track, palpate, scan, look."""
    collection: Inlined[CollectionConfig] = field(default_factory=CollectionConfig)
    environment: Inlined[LearnerOptions] = field(default_factory=LearnerOptions)
    perception: str | None = None
    """Depth estimator of environment and expert; by default compact where depth is observed, exact depth elsewhere."""
    randomisation: str = "none"
    """What differs between episodes: none, narrow, wide, or the path of a TOML file."""
    perturbation: Inlined[Perturbation] = field(default_factory=Perturbation)
    format: Annotated[Literal["minari", "lerobot"], tyro.conf.arg(help="Of the data set.")] = "minari"
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(DemonstrateArguments, arguments, "demonstrate")
    config = DemonstrationConfig(
        task=chosen.task,
        environment=chosen.environment,
        perception=chosen.perception,
        randomisation=dict(randomisation_of(chosen.randomisation).plain),
        perturbation=chosen.perturbation,
    )

    from laploop.studies.demonstrations.dataset import make_dataset, summarise  # slow to import

    wanted = chosen.collection.episodes
    with OutputFolder(chosen.out, "demonstrate") as folder:
        with progress_bar("episodes", wanted) as advance_to:
            path, collected = make_dataset(config, chosen.collection, chosen.format, folder.path, advance_to)
        results = {"task": config.task, "format": chosen.format, "dataset": str(path), **summarise(collected, wanted)}
        folder.write_summary(results, config={"demonstration": config, **vars(chosen)}, seed=chosen.collection.seed)
    table = ResultTable(f"{config.task}, {results['episodes']} episodes, {chosen.format}")
    table.row("success", 100.0 * results["success_rate"], f"% of the {results['tried']} seeds tried")
    table.row("decisions", str(results["decisions"]))
    table.row("return, mean", results["return_mean"])
    table.row("pushes", str(results["pushes"]))
    table.show(path)
    for failed in results["failed"]:
        sys.stderr.write(f"laploop demonstrate: seed {failed['seed']}: {failed['error']}\n")
    return 0 if results["episodes"] == wanted else 1
