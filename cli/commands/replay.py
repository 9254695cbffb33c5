"""`laploop replay`: an episode of a data set once more, compared with what was recorded."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import tyro

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse

_SHOWN = 20
"""Differences in the table."""


@dataclass(frozen=True, kw_only=True)
class ReplayArguments:
    """Step the environment of a data set along the actions of an episode, and compare every observation to the bit.

    Prints what differs; the exit status is 1 if anything does. With --out it also writes `summary.json`, and the episode as
    `recording.rrd` for Rerun.
    """

    dataset: tyro.conf.Positional[Path]
    """A data set, or the folder that `laploop demonstrate` wrote one to."""
    episode: int = 0
    """Its number, from 0 on."""
    view: bool = False
    """Show the episode in a Rerun viewer."""
    trust: bool = False
    """Accept module:Class from the data set, which runs the code it names."""
    out: Path | None = None
    """Folder to write to; made where it does not exist."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(ReplayArguments, arguments, "replay")

    from laploop.studies.code_digest import code_digest
    from laploop.studies.demonstrations.recorded import checked_index, open_demonstrations  # slow to import
    from laploop.studies.demonstrations.replay import replay

    found = open_demonstrations(chosen.dataset)
    same_code = found.card.code == code_digest("demonstrations")
    outcome = found.episode(checked_index(chosen.episode, found.count)).outcome
    with ExitStack() as outer:
        folder = None if chosen.out is None else outer.enter_context(OutputFolder(chosen.out, "replay"))
        with ExitStack() as inner, progress_bar("decisions", outcome["decisions"]) as advance_to:
            recorder = None
            if folder is not None:
                from laploop.envs.recording.rerun_recorder import RerunRecorder

                recorder = inner.enter_context(RerunRecorder(inner.enter_context(folder.own_artefact("recording.rrd"))))
            result = replay(
                found,
                chosen.episode,
                recorder=recorder,
                render_mode="human" if chosen.view else None,
                trust=chosen.trust,
                progress=advance_to,
            )
        if folder is not None:
            results = {
                "frames": result.frames,
                "differing_frames": result.differing_frames,
                "differences": result.differences,
                "same_code": same_code,
            }
            folder.write_summary({"task": found.card.task, **results}, config=chosen, seed=outcome["seed"])
    table = ResultTable(f"{found.card.task}, episode {chosen.episode}, seed {outcome['seed']}")
    table.row("frames compared", str(result.frames))
    table.row("frames that differ", str(result.differing_frames))
    table.row("made by", "this code" if same_code else "other code of this version")
    for one in result.differences[:_SHOWN]:
        table.row(f"frame {one.frame}, {one.what}", one.largest, f"off at most, {one.entries} numbers")
    if len(result.differences) > _SHOWN:
        table.row("and more", str(len(result.differences) - _SHOWN))
    table.show(chosen.out)
    return 1 if result.differences else 0
