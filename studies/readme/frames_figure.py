"""A picture of every frame and of the chain of transforms, from the poses of the compiled theatre.

`python -P -m laploop.studies.readme.frames_figure docs/pictures/frames.png` draws it.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from laploop.arrays import Array
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.studies.figure_style import BLUE, GREY, ORANGE, figure_page, hide_frame
from laploop.whole_file import whole_file

_AXIS_COLOURS = ("#c62828", "#2e7d32", "#1565c0")
_CHAIN = (
    ("world", "base", "world_from_base", "where an arm stands"),
    ("base", "flange", "forward kinematics of q", "from the joint angles"),
    ("flange", "camera", "flange_from_camera", "hand-eye calibration"),
    ("camera", "projector", "projector_from_camera", "5 mm to the side"),
)
"""From, to, transform, where it comes from."""


def frames_of(theatre: Theatre) -> dict[str, Array]:
    """Return the pose in the world, 4x4, of every named frame."""
    frames = {"world": np.eye(4), "camera": theatre.world_from_camera(), "projector": theatre.world_from_projector()}
    for arm in theatre.arms:
        name = arm.name.rstrip("/").replace("_", " ")
        shaft = theatre.world_from_shaft(arm)
        back = np.eye(4)
        back[2, 3] = -arm.shaft.length_m
        frames |= {f"{name}: base": arm.world_from_base, f"{name}: flange": shaft @ back, f"{name}: shaft tip": shaft}
    return frames


def draw_frames(path: Path, *, seed: int = 1) -> None:
    """Draw the theatre from the side with its frames, the tip of the scope, and the chain of transforms.

    Raises:
        OutputError: If the picture cannot be written.
    """
    theatre = Theatre(TheatreConfig(), seed=seed)
    frames = frames_of(theatre)
    with whole_file(path) as partial, figure_page(partial, title="Frames", width_in=11.0, height_in=5.4) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=[1.9, 1.0])
        _draw_theatre(figure.add_subplot(grid[:, 0]), theatre, frames)
        _draw_scope_tip(figure.add_subplot(grid[0, 1]), frames)
        _draw_chain(figure.add_subplot(grid[1, 1]))


def _draw_theatre(axis: Axes, theatre: Theatre, frames: dict[str, Array]) -> None:
    wall = theatre.config.layout.wall_z_m
    axis.axhspan(1e3 * wall - 3.0, 1e3 * wall + 3.0, color="#f2d7c9", zorder=0)
    axis.annotate("abdominal wall", (-590.0, 1e3 * wall + 8.0), color=GREY)
    surface = 1e3 * theatre.tissue.surface_points()
    near = surface[np.abs(surface[:, 1]) < 2.0]
    axis.plot(near[:, 0], near[:, 2], ".", color="#d98880", markersize=2)
    for arm, colour in zip(theatre.arms, (BLUE, ORANGE), strict=True):
        _draw_arm(axis, arm, frames, colour)
    camera = frames["camera"]
    for side in (-1.0, 1.0):
        edge = camera[:3, 3] + 0.12 * (camera[:3, 2] + side * np.tan(np.deg2rad(30.0)) * camera[:3, 0])
        axis.plot(*_plane([camera[:3, 3], edge]), ":", color=GREY, linewidth=0.8)
    for name, pose in frames.items():
        if name != "projector":
            _draw_axes(axis, pose, 0.07)
    offsets = {"world": (8, -14), "camera": (-52, 2), "base": (8, -14), "flange": (8, 6), "shaft tip": (22, 2)}
    for name, pose in frames.items():
        short = name.rpartition(": ")[2]
        if name not in {"projector", "camera arm: shaft tip"}:
            axis.annotate(short, _point(pose), textcoords="offset points", xytext=offsets[short], fontsize=8)
    axis.set(xlabel="x of the world, mm", ylabel="z of the world, mm", ylim=(-70.0, 690.0), aspect="equal")
    axis.set_title("the theatre from the side: x red, y green, z blue")


def _draw_arm(axis: Axes, arm: Arm, frames: dict[str, Array], colour: str) -> None:
    name = arm.name.rstrip("/").replace("_", " ")
    base, flange, tip = (frames[f"{name}: {part}"][:3, 3] for part in ("base", "flange", "shaft tip"))
    axis.plot(*_plane([base, flange]), "--", color=colour, linewidth=1.0, label=f"{name} (its links left out)")
    axis.plot(*_plane([flange, tip]), color=colour, linewidth=3.0, solid_capstyle="butt")
    x, z = _plane([arm.trocar_in_world])
    axis.plot(x, z, "o", color="white", markeredgecolor=colour, markersize=7)
    axis.annotate("trocar", (x[0], z[0]), textcoords="offset points", xytext=(9, 7), fontsize=8, color=colour)
    axis.legend(loc="upper right", frameon=False, fontsize=8)


def _draw_scope_tip(axis: Axes, frames: dict[str, Array]) -> None:
    camera, projector = frames["camera"], frames["projector"]
    middle = 0.5 * (camera[:3, 3] + projector[:3, 3])
    for name, pose in (("camera", camera), ("projector", projector)):
        moved = pose.copy()
        moved[:3, 3] -= middle
        _draw_axes(axis, moved, 0.003)
        axis.annotate(name, _point(moved), textcoords="offset points", xytext=(0, 8), ha="center", fontsize=8)
    apart = 1e3 * np.linalg.norm(projector[:3, 3] - camera[:3, 3])
    axis.set(xlabel="x of the world, mm", aspect="equal", xlim=(-6.0, 6.0), ylim=(-4.5, 2.5))
    axis.set_title(f"tip of the scope: {apart:.1f} mm apart, both look down")


def _draw_chain(axis: Axes) -> None:
    hide_frame(axis)
    axis.set(xlim=(0.0, 1.0), ylim=(-0.6, len(_CHAIN) + 0.6), title="the chain of the camera's arm")
    heights = np.arange(len(_CHAIN), -1, -1.0)
    names = [_CHAIN[0][0], *(link[1] for link in _CHAIN)]
    for name, height in zip(names, heights, strict=True):
        axis.text(0.17, height, name, ha="center", va="center", bbox={"boxstyle": "round", "fc": "#eef3f8", "ec": BLUE})
    for (_, _, transform, source), height in zip(_CHAIN, heights, strict=False):
        axis.annotate("", (0.17, height - 0.75), (0.17, height - 0.25), arrowprops={"arrowstyle": "->", "color": GREY})
        axis.text(0.34, height - 0.42, transform, family="monospace", fontsize=8, va="center")
        axis.text(0.34, height - 0.66, source, color=GREY, fontsize=7, va="center")


def _draw_axes(axis: Axes, pose: Array, length_m: float) -> None:
    for column, colour in enumerate(_AXIS_COLOURS):
        x, z = _plane([pose[:3, 3], pose[:3, 3] + length_m * pose[:3, column]])
        if np.hypot(x[1] - x[0], z[1] - z[0]) > 0.2 * 1e3 * length_m:
            axis.annotate(
                "",
                (x[1], z[1]),
                (x[0], z[0]),
                arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.4, "shrinkA": 0, "shrinkB": 0},
            )
        else:
            axis.plot(x[0], z[0], "o", color=colour, markersize=3, zorder=5)


def _plane(points: Sequence[Array]) -> tuple[Array, Array]:
    """Return x and z in millimetres, the plane in which the theatre lies."""
    array = 1e3 * np.asarray(points, dtype=np.float64)
    return array[:, 0], array[:, 2]


def _point(pose: Array) -> tuple[float, float]:
    return 1e3 * float(pose[0, 3]), 1e3 * float(pose[2, 3])


if __name__ == "__main__":
    draw_frames(Path(sys.argv[1]))
