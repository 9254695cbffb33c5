"""`laploop run`: one closed-loop episode."""

import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath
from laploop.cli.tree_options import TreeOptions, parse_tree, with_options
from laploop.configuration import to_plain
from laploop.envs.recording.episode_log import EpisodeLog
from laploop.envs.recording.recorder import ARM_NAMES, STAGES, CompositeRecorder, Recorder
from laploop.envs.recording.rerun_detail import DetailName
from laploop.envs.recording.viewer import RECORDING, live_viewer
from laploop.errors import InvalidValueError
from laploop.whole_file import whole_file


@dataclass(frozen=True, kw_only=True)
class RunArguments:
    """Run one closed-loop episode with the scripted controller.

    Writes `episode.png`, `recording.rrd` (`laploop view DIR` opens it), `ticks.parquet` (a row a control tick),
    `timing.csv` (a row a frame) and `summary.json`; where service or computing times are measured, also `service_trace.csv` and
    `compute_trace.csv`, with which --latency-trace and --compute-trace repeat the episode. The exit status is 0 when it ran to
    its end, with or without success; an episode that is interrupted leaves its recording up to then. Every field of the
    configuration is an option, such as --loop.camera-hz 50; --help-all lists them.
    """

    tree: Inlined[TreeOptions] = field(default_factory=TreeOptions)
    out: OutputPath
    rerun: bool = True
    """Write the Rerun recording."""
    detail: DetailName = "default"
    """How much the recording keeps: default (at most 2 MB a simulated second), or full (about 7 MB; depth as numbers)."""
    live: bool = False
    """Show the recording while it is made: in the viewer that listens at 127.0.0.1:9876, or in a window of a new one."""
    video: Path | None = None
    """MP4 file to write what the scope sees, its depth and the theatre to, side by side, in simulated time."""
    trace_out: Path | None = None
    """JSON file to write the times of all frames and commands to, as Chrome trace events; https://ui.perfetto.dev opens it."""

    def __post_init__(self) -> None:
        if self.trace_out is not None and (self.trace_out.is_dir() or self.trace_out.suffix != ".json"):
            raise InvalidValueError("trace_out", self.trace_out, "the path of a .json file")
        if self.live and not self.rerun:
            raise InvalidValueError("live", self.live, "only with a recording, without --no-rerun")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen, rest = parse_tree(RunArguments, arguments, "run")
    episode = with_options(chosen.tree.tree(), rest, RunArguments)

    # Slow to import.
    from laploop.envs.episode import run_episode
    from laploop.envs.recording.tick_table import TickTable

    with OutputFolder(chosen.out, "run") as folder:
        log, ticks = EpisodeLog(), TickTable()
        with ExitStack() as stack:
            recorders: list[Recorder] = [log]
            if chosen.rerun:
                from laploop.envs.recording.rerun_recorder import RerunRecorder

                path = stack.enter_context(folder.own_artefact(RECORDING))
                live = live_viewer() if chosen.live else None
                recorders.append(stack.enter_context(RerunRecorder(path, detail=chosen.detail, live=live)))
            if chosen.video is not None:
                from laploop.envs.recording.video_recorder import VideoRecorder

                recorders.append(stack.enter_context(VideoRecorder(chosen.video, camera_hz=episode.task.loop.camera_hz)))
            with progress_bar("simulated seconds", episode.task.max_seconds) as advance_to:
                results = run_episode(episode, CompositeRecorder(recorders), advance_to, ticks=ticks)

        from laploop.envs.recording.chrome_trace import chrome_trace
        from laploop.studies.episodes.episode_figure import draw_episode
        from laploop.studies.episodes.timing_tables import frames_csv, measured_traces

        with folder.artefact("episode.png") as path:
            draw_episode(log, {"seed": episode.seed, **results}, path)
        with folder.artefact("ticks.parquet") as path:
            ticks.write(path)
        folder.write_text("timing.csv", frames_csv(log.times))
        timing = episode.task.loop.timing
        for name, text in measured_traces(log.times, timing).items():
            folder.write_text(name, text)
        if chosen.trace_out is not None:
            with whole_file(chosen.trace_out) as path:
                path.write_text(json.dumps(chrome_trace(log.times, timing)), encoding="utf-8")
        summary = folder.write_summary(results, config=to_plain(episode), seed=episode.seed)
    _show(summary, folder.path, recorded=chosen.rerun)
    return 0


def _show(summary: Mapping[str, Any], folder: Path, *, recorded: bool) -> None:
    table = ResultTable(f"{summary['task']}, {summary['perception']}, {summary['motion']}, seed {summary['seed']}")
    table.row("outcome", "success" if summary["success"] else f"no success: ended by {summary['terminated_by']}")
    table.row("target error", summary["target_error_mm"]["final"], "mm, at the end")
    for name, value in summary["metrics"].items():
        table.row(name.replace("_", " "), value)
    if summary["fault_ticks"]:
        table.row("commands not followed", str(sum(summary["fault_ticks"].values())), ", ".join(summary["fault_ticks"]))
    for arm in ARM_NAMES:
        table.row(f"trocar error, {arm} arm", summary["rcm_error_mm"][f"{arm}_max"], "mm, worst")
    table.row("force at a trocar", max(summary["port_force_n"].values()), "N, worst, sideways")
    used = max(value for name, value in summary["limits"].items() if name.endswith("_share"))
    table.row("joint limits", 100.0 * used, "% used, worst")
    table.row("contact force", summary["contact_force_n"]["max"], "N, worst")
    table.row("depth error", summary["depth_mae_mm"], "mm, mean absolute")
    table.row("valid depth", 100.0 * summary["depth_valid_fraction"], "% of the pixels")
    table.row("age of depth", summary["depth_age_ms"]["mean"], "ms, mean")
    dropped = {fate: count for fate, count in summary["dropped"].items() if count}
    if dropped:
        table.row("frames dropped", str(sum(dropped.values())), ", ".join(f"{count} {fate}" for fate, count in dropped.items()))
    for name in ("out_of_order", "overtaken_commands"):
        if summary[name]:
            table.row(name.replace("_", " "), str(summary[name]), "frames" if name == "out_of_order" else "")
    table.row("simulated", summary["sim_s"], f"s, {summary['frames']} frames")
    table.row("real-time factor", summary["real_time_factor"], "with recording" if recorded else "")
    for stage in STAGES:
        table.row(f"{stage} time", summary["stage_ms"].get(stage), "ms, median")
    table.show(folder)
