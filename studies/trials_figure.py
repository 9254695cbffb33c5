"""Many episodes on one page."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from laploop.studies.trials import Row

SUCCESS_RADIUS_MM = 1.5
FORCE_LIMIT_N = 2.0
RCM_LIMIT_MM = 0.5

_BLUE, _RED, _GREY = "#0072B2", "#D55E00", "#666666"
_STYLE = {"font.size": 9, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False}


def draw_trials(rows: Sequence[Row], title: str, path: Path | str) -> None:
    """Draw final error, worst force and worst trocar error of every episode, sorted by error, with their limits, as a PNG."""
    ended = sorted((row for row in rows if row["final_error_mm"] is not None), key=lambda row: row["final_error_mm"])
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 6.4), dpi=130, layout="constrained")
        FigureCanvasAgg(figure)
        figure.suptitle(title, fontsize=12, fontweight="bold")
        error, force, rcm = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        places = np.arange(len(ended))
        colors = [_BLUE if row["success"] else _RED for row in ended]
        _bars(error, places, [row["final_error_mm"] for row in ended], colors, SUCCESS_RADIUS_MM, "final target\nerror [mm]")
        _bars(force, places, [row["contact_force_n"] for row in ended], colors, FORCE_LIMIT_N, "worst contact\nforce [N]")
        worst = [max(row["rcm_camera_mm"], row["rcm_tool_mm"]) for row in ended]
        _bars(rcm, places, worst, colors, RCM_LIMIT_MM, "worst trocar\nerror [mm]")
        rcm.set_xticks(places, [str(row["seed"]) for row in ended], rotation=90 if len(ended) > 20 else 0)
        rcm.set_xlabel("seed, by final error  (blue: success, red: no success, dashed: limit)")
        figure.align_ylabels([error, force, rcm])
        figure.savefig(path, format="png")


def _bars(axis: Axes, places: Any, values: Sequence[float], colors: Sequence[str], limit: float, label: str) -> None:
    axis.bar(places, values, color=colors, width=0.8)
    axis.axhline(limit, color=_GREY, linewidth=0.8, linestyle="--")
    axis.set_ylabel(label)
    axis.grid(visible=True, axis="y", color="#e6e6e6", linewidth=0.6)
    axis.set_axisbelow(True)
