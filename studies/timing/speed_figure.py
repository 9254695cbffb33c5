"""The figure of a speed measurement: how often each frequency occurred, and the trace."""

from pathlib import Path

import numpy as np

from laploop.studies.figure_style import BLUE, GREY, ORANGE, RED, draw_grid, figure_page
from laploop.studies.timing.speed import SpeedResult

_FREE_BINS = 30


def draw_speed(result: SpeedResult, title: str, path: Path | str) -> None:
    """Draw the distribution of the frames' frequencies, as the paper does, above the latency of every frame."""
    numbers = result.as_dict()
    hertz = 1e3 / result.latency_ms
    with figure_page(path, title=title, width_in=7.0, height_in=5.6) as figure:
        top, bottom = figure.subplots(2, 1)
        top.hist(hertz, bins=_FREE_BINS, color=BLUE, edgecolor="white", linewidth=0.4)
        mean = numbers["hz"]
        top.axvline(mean, color=RED, linewidth=1.4, label=f"mean {mean:.1f} Hz, {numbers['mean_ms']:.2f} ms a frame")
        top.set(xlabel="inference frequency [Hz]", ylabel="frames", title=f"Frequency of {len(hertz)} consecutive frames")
        top.legend(frameon=False, loc="upper left")
        bottom.plot(np.arange(len(hertz)), result.latency_ms, color=BLUE, linewidth=0.9)
        for name, colour in (("p50", GREY), ("p99", ORANGE)):
            value = numbers[f"{name}_ms"]
            bottom.axhline(value, color=colour, linewidth=1.0, linestyle="--", label=f"{name} {value:.2f} ms")
        bottom.set(xlabel="frame", ylabel="latency [ms]", title=f"Trace; the slowest frame took {numbers['max_ms']:.2f} ms")
        bottom.set_ylim(bottom=0.0)
        bottom.legend(frameon=False, ncols=2)
        for axis in (top, bottom):
            draw_grid(axis)
