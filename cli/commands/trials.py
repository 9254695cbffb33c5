"""`laploop trials`: many episodes, one a seed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.studies.episodes.trials import TrialsConfig, as_csv, as_markdown, run_trials, summarise
from laploop.studies.episodes.trials_figure import draw_trials


@dataclass(frozen=True, kw_only=True)
class TrialsArguments:
    """Run many closed-loop episodes that differ in their seed alone.

    Writes `trials.csv`, `trials.md`, `trials.png` and `summary.json`. Finished episodes are kept in `DIR/rows`: the same
    command resumes where it was stopped. The exit status is 1 if an episode could not be run.
    """

    trials: tyro.conf.OmitArgPrefixes[TrialsConfig] = field(default_factory=TrialsConfig)
    out: Path
    """Folder to write to; made where it does not exist."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(TrialsArguments, arguments, "trials")
    config = chosen.trials
    with OutputFolder(chosen.out, "trials") as folder:
        with progress_bar("episodes", config.seeds) as advance_to:
            rows = run_trials(config, folder.path, advance_to)
        results = summarise(rows)
        episode = config.episode
        folder.write_text("trials.csv", as_csv(rows))
        folder.write_text("trials.md", as_markdown(rows, results))
        with folder.artefact("trials.png") as path:
            title = f"{episode.task}  |  {episode.perception}  |  {episode.motion_name()}  |  {len(rows)} seeds"
            draw_trials(rows, title, path, task=episode.task.kind)
        folder.write_summary(results, config=chosen, seed=episode.seed)
    low, high = results["success_interval_95"]
    table = ResultTable(f"{episode.task}, {episode.perception}, {episode.motion_name()}, {len(rows)} seeds")
    table.row("success", 100.0 * results["success_rate"], f"% (95 % interval {100 * low:.0f} to {100 * high:.0f} %)")
    for name, value in results["final_error_mm"].items():
        table.row(f"final target error, {name}", value, "mm")
    table.row("contact force", results["contact_force_n"]["max"], "N, worst")
    table.row("force at a trocar", results["port_force_n"]["max"], "N, worst, sideways")
    table.row("trocar error, camera arm", results["rcm_error_mm"]["camera_max"], "mm, worst")
    table.row("trocar error, tool arm", results["rcm_error_mm"]["tool_max"], "mm, worst")
    for name, value in results["metrics"].items():
        table.row(f"{name.replace('_', ' ')}, mean", value["mean"])
    failed = [row["seed"] for row in rows if row["error"] is not None]
    if failed:
        table.row("could not be run", str(len(failed)), f"seeds {', '.join(map(str, failed))}")
    table.show(folder.path)
    return 1 if failed else 0
