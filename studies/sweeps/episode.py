"""One episode of a study and its row."""

import math
from typing import Any

import numpy as np

from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.recording.tick_table import TickTable
from laploop.errors import InfeasibleError, SimulationError
from laploop.studies.episodes.trials import Row, failed_row, row_of
from laploop.studies.sweeps.step_response import step_response
from laploop.studies.sweeps.tick_metrics import tick_metrics


def run_study_episode(episode: EpisodeConfig) -> Row:
    """Run one episode and return its row, without anything that depends on the machine's speed.

    A failure of its physics or control becomes a row too.
    """
    import torch  # slow to import

    from laploop.envs.episode import run_episode  # slow to import

    # Sums of many threads depend on their number, and rows must not depend on how many workers share the cores.
    torch.set_num_threads(1)
    ticks = TickTable()
    try:
        summary = run_episode(episode, ticks=ticks)
    except (SimulationError, InfeasibleError) as error:
        return failed_row(episode.seed, error)
    row = row_of(episode.seed, summary)
    del row["real_time_factor"]
    if math.isnan(row["depth_mae_mm"]):
        # No pixel was valid in any frame.
        row["depth_mae_mm"] = None
    dropped = {"dropped_frames": sum(summary["dropped"].values())}
    row["metrics"] = {**row["metrics"], **_measured(episode, ticks), **dropped}
    return row


def _measured(episode: EpisodeConfig, ticks: TickTable) -> dict[str, Any]:
    time_s, task = ticks.series("time_s"), episode.task
    in_camera = np.stack([ticks.series(f"truth_in_camera_{axis}_m") for axis in "xyz"], axis=1)
    response: dict[str, Any] = {}
    if (working_distance_m := getattr(task, "working_distance_m", None)) is not None:
        # The camera moves: its error is the target's place in its frame.
        along_mm = 1e3 * (in_camera[:, 2] - working_distance_m)
        across_mm = 1e3 * np.hypot(in_camera[:, 0], in_camera[:, 1])
        response = step_response(time_s, in_camera[:, :2])
    else:
        along_mm = ticks.series("error_along_mm") - 1e3 * getattr(task, "standoff_m", 0.0)
        across_mm = ticks.series("error_across_mm")
    found = tick_metrics(
        time_s=time_s,
        along_mm=along_mm,
        across_mm=across_mm,
        assessed=ticks.series("assessed") == 1.0,
        force_n=ticks.series("contact_force_n"),
        age_ms=ticks.series("depth_age_ms"),
    )
    return {**found, **response}
