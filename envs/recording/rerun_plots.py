"""The plots of a recording: what each shows, and how control ticks get into them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import rerun as rr

from laploop.arrays import Array
from laploop.envs.loop.timing.log import FRAME_STAGES
from laploop.envs.recording.recorder import ARM_NAMES, STAGES, PredictionRecord, TickRecord

TIMELINE = "sim_time"

Color = tuple[int, int, int]

# Okabe and Ito's palette, which colour-blind readers can tell apart.
_BLUE, _ORANGE, _GREEN, _RED, _PURPLE = (0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (204, 121, 167)
_SKY, _GREY = (86, 180, 233), (120, 120, 120)
_PALETTE = (_BLUE, _ORANGE, _GREEN, _RED, _PURPLE, _SKY, _GREY)


@dataclass(frozen=True, kw_only=True)
class Series:
    """One line of a plot."""

    label: str
    """In the legend."""
    color: Color
    value: Callable[[TickRecord], float | None]
    """What a tick adds to it; None for nothing."""
    width: float = 1.5
    """In the viewer's points."""


@dataclass(frozen=True, kw_only=True)
class Plot:
    """One plot under `plots/`."""

    title: str
    """With the unit."""
    series: Mapping[str, Series]
    """By the entity below the plot."""
    range: tuple[float, float] | None = None
    """Initial range of the vertical axis; None lets the viewer choose."""


def _by_key(field: str, labels: Mapping[str, str], unit: str, colors: Sequence[Color]) -> dict[str, Series]:
    """Return a line for each key of a mapping in `TickRecord`."""
    return {
        key: Series(
            label=f"{label} [{unit}]",
            color=color,
            value=lambda tick, key=key: getattr(tick, field).get(key),  # type: ignore[misc]
        )
        for (key, label), color in zip(labels.items(), colors, strict=True)
    }


def _joints(field: str) -> dict[str, Series]:
    """Return a line for each joint of the moved arm, and one at its limit."""

    def value(joint: int) -> Callable[[TickRecord], float | None]:
        return lambda tick: None if (shares := getattr(tick, field)) is None else float(shares[joint])

    lines = {
        f"joint_{joint + 1}": Series(label=f"joint {joint + 1}", color=_PALETTE[joint], value=value(joint))
        for joint in range(6)
    }
    return {**lines, "limit": Series(label="limit", color=_RED, width=0.8, value=lambda _tick: 1.0)}


def _velocities() -> Iterator[tuple[str, Series]]:
    """Yield the lines of the commanded and the actual velocity, mm/s along the camera's axes: thin and thick."""

    def value(field: str, axis: int) -> Callable[[TickRecord], float | None]:
        return lambda tick: None if (vector := getattr(tick, field)) is None else 1e3 * float(vector[axis])

    for axis, (name, color) in enumerate(zip("xyz", (_RED, _GREEN, _BLUE), strict=True)):
        yield f"command_{name}", Series(label=f"{name} commanded", color=color, width=0.7, value=value("command_mps", axis))
        yield f"tip_{name}", Series(label=f"{name} actual", color=color, width=2.0, value=value("tip_velocity_mps", axis))


_MARKERS: Mapping[str, Color] = {"target": (60, 220, 90), "goal": (245, 245, 245), "prediction": (230, 159, 0)}
_MARKER_RADIUS_M = 0.0015

_ARMS = dict(zip(ARM_NAMES, ("camera arm", "tool arm"), strict=True))
_SHAFTS = dict(zip(ARM_NAMES, ("on the scope's shaft", "on the tool's shaft"), strict=True))
_OFF_GOAL = {"along": "along the normal", "across": "across it"}

PLOTS: Mapping[str, Plot] = {
    "target_error_mm": Plot(
        title="Target error [mm]",
        series={"target": Series(label="tip to target [mm]", color=_BLUE, value=lambda tick: tick.target_error_mm)},
    ),
    "off_goal_mm": Plot(title="Tip from its goal [mm]", series=_by_key("off_goal_mm", _OFF_GOAL, "mm", (_BLUE, _ORANGE))),
    "tip_velocity_mmps": Plot(
        title="Velocity of the tip [mm/s], camera's axes: thin commanded, thick actual", series=dict(_velocities())
    ),
    "joint_position_share": Plot(
        title="Joint angles over their limits", series=_joints("joint_position_share"), range=(0.0, 1.1)
    ),
    "joint_speed_share": Plot(title="Joint speeds over their limits", series=_joints("joint_speed_share"), range=(0.0, 1.1)),
    "force_n": Plot(
        title="Contact force [N]",
        series={"force": Series(label="tip on tissue [N]", color=_RED, value=lambda tick: tick.contact_force_n)},
    ),
    "rcm_error_mm": Plot(title="Trocar (RCM) error [mm]", series=_by_key("rcm_error_mm", _ARMS, "mm", (_ORANGE, _BLUE))),
    "port_force_n": Plot(
        title="Force of the wall at the trocar [N]", series=_by_key("port_force_n", _SHAFTS, "N", (_ORANGE, _BLUE))
    ),
    "depth_age_ms": Plot(
        title="Age of the newest depth frame [ms]",
        series={"age": Series(label="age [ms]", color=_GREEN, value=lambda tick: tick.depth_age_ms)},
    ),
    "dropped_frames": Plot(
        title="Frames dropped so far",
        series={"count": Series(label="frames", color=_RED, value=lambda tick: float(tick.dropped_frames))},
    ),
    "frame_ms": Plot(
        title="Age of the newest used frame by stage [ms]",
        series=_by_key(
            "frame_ms", dict(zip(FRAME_STAGES, FRAME_STAGES, strict=True)), "ms", (_SKY, _GREY, _GREEN, _PURPLE, _ORANGE)
        ),
    ),
    "stage_ms": Plot(
        title="Wall time by stage [ms]",
        series=_by_key(
            "stage_ms", dict(zip(STAGES, STAGES, strict=True)), "ms", (_BLUE, _SKY, _ORANGE, _GREEN, _GREY, _RED, _PURPLE)
        ),
    ),
}
"""By the entity under `plots/`; those of the predictions and of the reward are made beside them."""

PREDICTION_PLOTS = {
    "target_depth_mm": "Depth of the target [mm], camera's z: predicted and true",
    "prediction_error_mm": "Error of the predicted target [mm]",
}
REWARD_PLOT = "reward"

_PREDICTIONS: Mapping[str, tuple[str, Color, Callable[[PredictionRecord], float]]] = {
    "target_depth_mm/predicted": ("predicted [mm]", _ORANGE, lambda record: 1e3 * float(record.predicted_in_camera[2])),
    "target_depth_mm/true": ("true [mm]", _BLUE, lambda record: 1e3 * float(record.true_in_camera[2])),
    "prediction_error_mm/distance": (
        "distance [mm]",
        _PURPLE,
        lambda record: 1e3 * float(np.linalg.norm(record.predicted_in_camera - record.true_in_camera)),
    ),
}

STATES: Mapping[str, Callable[[TickRecord], str]] = {
    "status": lambda tick: tick.status,
    "reason": lambda tick: tick.status_reason,
    "faults": lambda tick: tick.faults,
}
"""Lanes of states under `states/`: outcome of the inverse kinematics, what holds the arm back, faults."""


class TickPlots:
    """Sends control ticks and predictions to a recording, each series of a batch in one call: every call is expensive."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        """Log how the lines look."""
        self._stream = stream
        self._states: dict[str, str] = {}
        self._terms: set[str] = set()
        self._marked: set[str] = set()
        for name, plot in PLOTS.items():
            for entity, series in plot.series.items():
                self._style(f"{name}/{entity}", series.label, series.color, series.width)
        for path, (label, color, _) in _PREDICTIONS.items():
            self._style(path, label, color)

    def send(self, ticks: Sequence[TickRecord], predictions: Sequence[PredictionRecord]) -> None:
        """Send a batch."""
        for name, plot in PLOTS.items():
            for entity, series in plot.series.items():
                self._scalars(f"{name}/{entity}", [(tick.now_ns, series.value(tick)) for tick in ticks])
        for path, (_, _, value) in _PREDICTIONS.items():
            self._scalars(path, [(record.now_ns, value(record)) for record in predictions])
        for term in dict.fromkeys(term for tick in ticks for term in tick.reward_terms):
            if term not in self._terms:
                self._style(f"{REWARD_PLOT}/{term}", term, _PALETTE[len(self._terms) % len(_PALETTE)])
                self._terms.add(term)
            self._scalars(f"{REWARD_PLOT}/{term}", [(tick.now_ns, tick.reward_terms.get(term)) for tick in ticks])
        for lane, state in STATES.items():
            self._changes(lane, [(tick.now_ns, state(tick)) for tick in ticks])
        self._marker("target", [(tick.now_ns, tick.target_in_world) for tick in ticks])
        self._marker("goal", [(tick.now_ns, tick.goal_in_world) for tick in ticks])
        self._marker("prediction", [(record.now_ns, record.predicted_in_world) for record in predictions])

    def _style(self, path: str, label: str, color: Color, width: float = 1.5) -> None:
        self._stream.log(f"plots/{path}", rr.SeriesLines(names=[label], colors=[color], widths=[width]), static=True)

    def _scalars(self, path: str, samples: Sequence[tuple[int, float | None]]) -> None:
        known = [(now_ns, value) for now_ns, value in samples if value is not None]
        if known:
            columns = rr.Scalars.columns(scalars=[value for _, value in known])
            self._stream.send_columns(f"plots/{path}", [times([now_ns for now_ns, _ in known])], columns)

    def _marker(self, name: str, samples: Sequence[tuple[int, Array | None]]) -> None:
        """Send the places of a marker; it is drawn from the first of them on."""
        known = [(now_ns, point) for now_ns, point in samples if point is not None]
        if not known:
            return
        columns = rr.Transform3D.columns(translation=np.stack([point for _, point in known]))
        self._stream.send_columns(f"world/{name}", [times([now_ns for now_ns, _ in known])], columns)
        if name not in self._marked:
            self._marked.add(name)
            ball = rr.Points3D.columns(positions=[[0.0, 0.0, 0.0]], radii=[_MARKER_RADIUS_M], colors=[_MARKERS[name]])
            self._stream.send_columns(f"world/{name}", [times([known[0][0]])], ball)

    def _changes(self, lane: str, samples: Sequence[tuple[int, str]]) -> None:
        """Send the ticks at which a state changes."""
        if not samples:
            return
        first = (samples[0][0], self._states.get(lane))
        changed = [after for before, after in pairwise([first, *samples]) if before[1] != after[1]]
        self._states[lane] = samples[-1][1]
        if changed:
            columns = rr.StateChange.columns(state=[state or "none" for _, state in changed])
            self._stream.send_columns(f"states/{lane}", [times([now_ns for now_ns, _ in changed])], columns)


def times(now_ns: Sequence[int]) -> rr.TimeColumn:
    """Return simulated times as a column."""
    return rr.TimeColumn(TIMELINE, duration=np.array(now_ns, dtype="timedelta64[ns]"))
