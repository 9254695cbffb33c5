"""`laploop trials`: many episodes, one a seed."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath
from laploop.cli.tree_options import TreeOptions, parse_tree, with_options
from laploop.configuration import to_plain
from laploop.studies.episodes.trials import TrialsConfig, as_csv, as_markdown, run_trials, summarise


@dataclass(frozen=True, kw_only=True)
class TrialsArguments:
    """Run many closed-loop episodes that differ in their seed alone.

    Writes `trials.csv`, `trials.md`, `trials.png` and `summary.json`. Finished episodes are kept in `DIR/rows`: the same
    command resumes where it was stopped. The exit status is 1 if an episode could not be run. Every field of the
    configuration is an option, such as --loop.camera-hz 50; --help-all lists them.
    """

    tree: Inlined[TreeOptions] = field(default_factory=TreeOptions)
    seeds: int = 30
    """How many episodes; the first has the seed of the configuration, each further one the next."""
    workers: int = 1
    """Processes that run episodes at the same time."""
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen, rest = parse_tree(TrialsArguments, arguments, "trials")
    episode = with_options(chosen.tree.tree(), rest, TrialsArguments)
    config = TrialsConfig(episode=episode, seeds=chosen.seeds, workers=chosen.workers)

    from laploop.studies.episodes.trials_figure import draw_trials  # slow to import

    with OutputFolder(chosen.out, "trials") as folder:
        with progress_bar("episodes", config.seeds) as advance_to:
            rows = run_trials(config, folder.path, advance_to)
        results = summarise(rows)
        folder.write_text("trials.csv", as_csv(rows))
        folder.write_text("trials.md", as_markdown(rows, results))
        with folder.artefact("trials.png") as path:
            title = f"{episode.task.kind}  |  {episode.perception.name}  |  {episode.motion_name()}  |  {len(rows)} seeds"
            draw_trials(rows, title, path, task=episode.task.kind)
        what = {"task": episode.task.kind, "perception": episode.perception.name, "motion": episode.motion_name()}
        used = {"episode": to_plain(episode), "seeds": config.seeds, "workers": config.workers}
        folder.write_summary({**what, **results}, config=used, seed=episode.seed)
    low, high = results["success_interval_95"]
    table = ResultTable(f"{episode.task.kind}, {episode.perception.name}, {episode.motion_name()}, {len(rows)} seeds")
    table.row("success", 100.0 * results["success_rate"], f"% (95 % interval {100 * low:.0f} to {100 * high:.0f} %)")
    for name, value in results["final_error_mm"].items():
        table.row(f"final target error, {name}", value, "mm")
    table.row("contact force", results["contact_force_n"]["max"], "N, worst")
    table.row("force at a trocar", results["port_force_n"]["max"], "N, worst, sideways")
    for arm in ("camera", "tool"):
        table.row(f"trocar error, {arm} arm", results["rcm_error_mm"][f"{arm}_max"], "mm, worst")
    for name, value in results["metrics"].items():
        table.row(f"{name.replace('_', ' ')}, mean", value["mean"])
    failed = [row["seed"] for row in rows if row["error"] is not None]
    if failed:
        table.row("could not be run", str(len(failed)), f"seeds {', '.join(map(str, failed))}")
    table.show(folder.path)
    return 1 if failed else 0
