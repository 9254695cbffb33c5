"""The table of tasks: campaigns of episodes, measured against their targets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from laploop.configuration import Field, configuration
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.fidelity import FidelityName, with_fidelity
from laploop.errors import OutputError, UnknownNameError
from laploop.studies.csv_text import csv_text
from laploop.studies.episodes.task_campaigns import CAMPAIGNS, Campaign, campaigns
from laploop.studies.episodes.trials import Row, TrialsConfig, run_trials

MET = {None: "", True: "yes", False: "no"}
"""How the table says whether a number meets its target; empty where it has none."""

_COLUMNS = ("campaign", "episodes", "success_rate", "name", "unit", "statistic", "value", "min", "max", "missing", "bar", "met")


@configuration
class TaskTableConfig:
    """Which campaigns to run, and how many episodes of each."""

    seeds: Annotated[int, Field(ge=1, le=100_000)] = 30
    """Episodes of a campaign."""
    first_seed: Annotated[int, Field(ge=0, lt=2**31 - 100_000)] = 0
    """Seed of the first of them."""
    workers: Annotated[int, Field(ge=1, le=1024)] = 1
    """Processes that run episodes at the same time."""
    only: tuple[str, ...] = ()
    """Names of campaigns; all if none is given."""
    fidelity: FidelityName = "full"
    """What the simulation may cost, as for `laploop run`. The targets are meant for full."""

    def __post_init__(self) -> None:
        names = [campaign.name for campaign in campaigns()]
        for name in self.only:
            if name not in names:
                raise UnknownNameError("campaign", name, names)

    def campaigns(self) -> tuple[Campaign, ...]:
        """Return the chosen campaigns in the order of the table."""
        chosen = (campaign for campaign in campaigns() if not self.only or campaign.name in self.only)
        if self.fidelity == "full":
            return tuple(chosen)
        return tuple(replace(one, episode=_with_fidelity(one.episode, self.fidelity)) for one in chosen)


def _with_fidelity(episode: EpisodeConfig, fidelity: FidelityName) -> EpisodeConfig:
    return replace(episode, task=with_fidelity(episode.task, fidelity))


def run_task_table(
    config: TaskTableConfig,
    out: Path,
    progress: Callable[[float], None] | None = None,
    campaigns: Sequence[Campaign] | None = None,
    run: Callable[[EpisodeConfig], Row] | None = None,
) -> dict[str, list[Row]]:
    """Run the episodes of the campaigns that have no row yet, and return the rows of each campaign.

    A finished episode is kept in `out/CAMPAIGN/rows`, as `laploop.studies.episodes.trials.run_trials` keeps it.

    Args:
        config: How many.
        out: An existing folder.
        progress: Called with the number of rows so far.
        campaigns: Used in place of those that the configuration chooses.
        run: Runs one episode; must be picklable with more than one worker.

    Raises:
        LaploopError: If something is wrong for every episode.
        WorkerError: If the worker processes cannot be started, or one of them dies.
        OutputError: If a folder cannot be made.
    """
    found: dict[str, list[Row]] = {}
    for number, campaign in enumerate(config.campaigns() if campaigns is None else campaigns):
        folder = out / campaign.name
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write {folder}: {error.strerror}") from error
        trials = TrialsConfig(
            episode=replace(campaign.episode, seed=config.first_seed), seeds=config.seeds, workers=config.workers
        )

        def advance(rows: float, before: int = number * config.seeds) -> None:
            if progress is not None:
                progress(before + rows)

        found[campaign.name] = run_trials(trials, folder, advance, run)
    return found


def summarise_tasks(rows: Mapping[str, Sequence[Row]], campaigns: Sequence[Campaign] = CAMPAIGNS) -> dict[str, Any]:
    """Return a line for each campaign that was run, in the order of the table, and whether all meet their targets."""
    lines = [campaign.result(rows[campaign.name], rows) for campaign in campaigns if campaign.name in rows]
    return {"campaigns": lines, "met": all(line["met"] for line in lines)}


def table_csv(summary: Mapping[str, Any]) -> str:
    """Write a line for each number as CSV."""
    lines = ({**line, **check, **(check["spread"] or {})} for line in summary["campaigns"] for check in line["checks"])
    return csv_text(_COLUMNS, ([line.get(name) for name in _COLUMNS] for line in lines))


def table_markdown(summary: Mapping[str, Any]) -> str:
    """Write the numbers of every campaign as Markdown, with their targets."""
    lines = ["# Tasks", ""]
    for line in summary["campaigns"]:
        low, high = line["success_interval_95"]
        prediction = "" if line["prediction"] is None else f", prediction {line['prediction']}"
        lines += [
            f"## {line['campaign']}",
            "",
            f"{line['task']}, {line['perception']}, {line['motion']}, {line['actuation']}{prediction}.",
            *([f"{line['about'][:1].upper()}{line['about'][1:]}."] if line["about"] else []),
            f"Success {100 * line['success_rate']:.1f} % of {line['episodes']} (95 %: {100 * low:.1f} to {100 * high:.1f} %).",
            *([f"{line['errors']} could not be run."] if line["errors"] else []),
            "",
            "| quantity | statistic | measured | min | max | target | met |",
            "|---|---|---|---|---|---|---|",
        ]
        for check in line["checks"]:
            spread = check["spread"] or {"min": None, "max": None}
            missing = f" ({check['missing']} without)" if check["missing"] else ""
            lines.append(
                f"| {check['name']} | {check['statistic']} | {quantity(check)}{missing} | {number(spread['min'])} "
                f"| {number(spread['max'])} | {check['bar']} | {MET[check['met']]} |"
            )
        lines.append("")
    return "\n".join(lines)


def quantity(check: Mapping[str, Any]) -> str:
    """Return a measured number with its unit."""
    return f"{number(check['value'])} {check['unit']}".strip()


def number(value: float | None) -> str:
    """Return a number with three figures; a dash for what was not measured."""
    return "-" if value is None else f"{value:.3g}"
