"""Many episodes on one page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from laploop.envs.tasks.configs import ReachConfig
from laploop.studies.episodes.trials import Row
from laploop.studies.figure_style import BLUE, RED, draw_grid, draw_limit, figure_page

SUCCESS_RADIUS_MM = ReachConfig.success_radius_m * 1e3
FORCE_LIMIT_N = ReachConfig.alarm_force_n
RCM_LIMIT_MM = 0.5


def draw_trials(rows: Sequence[Row], title: str, path: Path | str, *, task: str = "reach") -> None:
    """Draw final error, worst force and worst trocar error of every episode, sorted by error, as a PNG with their limits.

    The final error has a limit in `reach` alone.
    """
    ended = sorted((row for row in rows if row["final_error_mm"] is not None), key=lambda row: row["final_error_mm"])
    with figure_page(path, title=title, width_in=9.0, height_in=6.4) as figure:
        error, force, rcm = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        places = np.arange(len(ended))
        colors = [BLUE if row["success"] else RED for row in ended]
        limit = SUCCESS_RADIUS_MM if task == "reach" else None
        _bars(error, places, [row["final_error_mm"] for row in ended], colors, limit, "final target\nerror [mm]")
        _bars(force, places, [row["contact_force_n"] for row in ended], colors, FORCE_LIMIT_N, "worst contact\nforce [N]")
        worst = [max(row["rcm_camera_mm"], row["rcm_tool_mm"]) for row in ended]
        _bars(rcm, places, worst, colors, RCM_LIMIT_MM, "worst trocar\nerror [mm]")
        rcm.set_xticks(places, [str(row["seed"]) for row in ended], rotation=90 if len(ended) > 20 else 0)
        rcm.set_xlabel("seed, by final error  (blue: success, red: no success, dashed: limit)")
        figure.align_ylabels([error, force, rcm])


def _bars(axis: Axes, places: Any, values: Sequence[float], colors: Sequence[str], limit: float | None, label: str) -> None:
    axis.bar(places, values, color=colors, width=0.8)
    axis.set_ylabel(label)
    if limit is not None:
        draw_limit(axis, limit)
    draw_grid(axis)
