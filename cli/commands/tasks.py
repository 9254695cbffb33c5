"""`laploop tasks`: the table of all tasks, measured against their targets."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath
from laploop.cli.tree_options import FileOptions, parse_tree, with_options
from laploop.configuration import to_plain
from laploop.studies.episodes.task_table import (
    TaskTableConfig,
    quantity,
    run_task_table,
    summarise_tasks,
    table_csv,
    table_markdown,
)
from laploop.studies.episodes.trials import as_csv
from laploop.studies.timing.machine import describe_machine


@dataclass(frozen=True, kw_only=True)
class TasksArguments:
    """Run every task under its reference conditions, over many seeds, and compare the results with their targets.

    Writes `tasks.md`, `tasks.csv`, a `trials.csv` for each campaign in a folder of its name, and `summary.json`. Finished
    episodes are kept: the same command resumes where it was stopped. The table says which targets are met; the exit status is 1
    only if an episode could not be run. A configuration file and options such as --loop.camera-hz change the episodes of all
    campaigns.
    """

    table: tyro.conf.OmitArgPrefixes[TaskTableConfig] = field(default_factory=TaskTableConfig)
    file: Inlined[FileOptions] = field(default_factory=FileOptions)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen, rest = parse_tree(TasksArguments, arguments, "tasks")
    config, plain = chosen.table, chosen.file.read()
    campaigns = tuple(
        replace(one, episode=with_options(one.episode.with_plain(plain, source=str(chosen.file.config)), rest, TasksArguments))
        for one in config.campaigns()
    )
    with OutputFolder(chosen.out, "tasks") as folder:
        with progress_bar("episodes", len(campaigns) * config.seeds) as advance_to:
            rows = run_task_table(config, folder.path, advance_to, campaigns)
        results = summarise_tasks(rows, campaigns)
        for name, found in rows.items():
            folder.write_text(f"{name}/trials.csv", as_csv(found))
        folder.write_text("tasks.csv", table_csv(results))
        folder.write_text("tasks.md", table_markdown(results))
        changed = {one.name: to_plain(one.episode) for one in campaigns if one not in config.campaigns()}
        used = {"table": config, "changed": changed}
        folder.write_summary({**results, "machine": describe_machine()}, config=used, seed=config.first_seed)
    table = ResultTable(f"{len(campaigns)} campaigns of {config.seeds} seeds")
    for line in results["campaigns"]:
        verdict = "meets its targets" if line["met"] else "MISSES a target"
        table.row(line["campaign"], f"{100 * line['success_rate']:.0f} % success", verdict)
        for check in line["checks"]:
            if check["met"] is False:
                table.row(f"  {check['name']}", quantity(check), f"target: {check['bar']}")
        if line["errors"]:
            table.row("  could not be run", str(line["errors"]), "episodes")
    table.show(folder.path)
    return 1 if any(line["errors"] for line in results["campaigns"]) else 0
