"""The look that the figures share."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

# Okabe and Ito's palette, which colour-blind readers can tell apart.
BLUE, ORANGE, RED, GREY = "#0072B2", "#E69F00", "#D55E00", "#666666"

_SETTINGS: dict[Any, Any] = {"font.size": 9, "axes.titlesize": 10, "axes.spines.top": False, "axes.spines.right": False}


@contextmanager
def figure_page(path: Path | str, *, title: str, width_in: float, height_in: float) -> Iterator[Figure]:
    """Give a figure to draw on and write it as a PNG at the end; no window, no state that outlives the block."""
    with mpl.rc_context(_SETTINGS):
        figure = Figure(figsize=(width_in, height_in), dpi=130, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.05))
        FigureCanvasAgg(figure)
        figure.suptitle(title, fontsize=12, fontweight="bold")
        yield figure
        figure.savefig(path, format="png")


def hide_frame(axis: Axes) -> None:
    """Leave nothing around a picture: no ticks, no border."""
    axis.set(xticks=[], yticks=[])
    axis.spines[:].set_visible(False)


def draw_limit(axis: Axes, value: float) -> None:
    """Draw a dashed line across."""
    axis.axhline(value, color=GREY, linewidth=0.8, linestyle="--")


def draw_grid(axis: Axes) -> None:
    """Draw a light grid behind the data."""
    axis.grid(visible=True, color="#e6e6e6", linewidth=0.6)
    axis.set_axisbelow(True)
