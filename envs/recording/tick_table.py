"""One row a control tick: what was commanded, believed and true."""

from pathlib import Path
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.envs.tasks.task_env import TaskEnv
from laploop.envs.tasks.tick_record import off_goal
from laploop.perception.geometry import invert_transform, transform_points

_VECTORS = {
    "command": "mps",
    "tip": "m",
    "tip_velocity": "mps",
    "goal": "m",
    "prediction": "m",
    "truth": "m",
    "truth_in_camera": "m",
}
_NUMBERS = ("error_along_mm", "error_across_mm", "contact_force_n", "depth_age_ms")
_TEXTS = ("status", "fault")


class TickTable:
    """Collects the control ticks of an episode, for a Parquet file.

    | column | meaning |
    |---|---|
    | `time_s` | simulated time of the tick |
    | `command_[xyz]_mps` | commanded velocity of the moved tip, along the camera's axes |
    | `tip_[xyz]_m`, `tip_velocity_[xyz]_mps` | the tool's tip as it really is, in the world |
    | `goal_[xyz]_m` | where its centre touches the true target, one ball radius above it, in the world |
    | `prediction_[xyz]_m` | where the controller takes the target to be now, in the world by its kinematics; empty if unknown |
    | `truth_[xyz]_m` | where the target really is, in the world |
    | `truth_in_camera_[xyz]_m` | the same in the true camera's frame |
    | `error_along_mm`, `error_across_mm` | tip from goal, along the target's normal (outwards positive) and across it |
    | `contact_force_n` | force on the tip, worst of the control period that begins |
    | `depth_age_ms` | age of the newest depth frame at the tick |
    | `assessed` | whether the tick counts for the task's accuracy |
    | `status`, `fault` | of the command: from the inverse kinematics, and why it was not followed; empty if it was |
    """

    def __init__(self) -> None:
        self._rows: list[dict[str, Any]] = []

    def begin(self, env: TaskEnv[Any], command: Array, predicted_in_camera: Array | None) -> None:
        """Take what is known and true at a tick, whose command, (3,) m/s, is not carried out yet."""
        loop = env.loop
        goal, along_mm, across_mm = off_goal(env)
        _, _, truth = env.target_offset()
        tip, unknown = loop.theatre.tip_in_world(), np.full(3, np.nan)
        prediction = unknown
        if predicted_in_camera is not None:
            prediction = transform_points(loop.scope.world_from_camera(), predicted_in_camera)
        served = loop.newest_served
        in_camera = transform_points(invert_transform(loop.theatre.world_from_camera()), truth)
        vectors = (command, tip, loop.theatre.tip_velocity_in_world(), goal, prediction, truth, in_camera)
        row: dict[str, Any] = {"time_s": loop.now_ns * 1e-9}
        for (name, unit), vector in zip(_VECTORS.items(), vectors, strict=True):
            row |= {f"{name}_{axis}_{unit}": _known(value) for axis, value in zip("xyz", vector.tolist(), strict=True)}
        row["error_along_mm"] = along_mm
        row["error_across_mm"] = across_mm
        row["depth_age_ms"] = None if served is None else served.age_ns(loop.now_ns) * 1e-6
        row["assessed"] = env.is_assessed()
        self._rows.append(row)

    def end(self, info: dict[str, Any]) -> None:
        """Take what became of the tick's command, from the environment's `info`."""
        self._rows[-1] |= {name: info[name] for name in ("contact_force_n", "status", "fault")}

    def series(self, name: str) -> Array:
        """Return a column of numbers, one a tick; NaN where it is empty."""
        return np.array([np.nan if row[name] is None else row[name] for row in self._rows], dtype=np.float64)

    def write(self, path: Path) -> None:
        """Write a Parquet file."""
        # Slow to import.
        import pyarrow as pa
        from pyarrow import parquet

        numbers = ("time_s", *(f"{name}_{axis}_{unit}" for name, unit in _VECTORS.items() for axis in "xyz"), *_NUMBERS)
        texts = ((name, pa.string()) for name in _TEXTS)
        schema = pa.schema([*((name, pa.float64()) for name in numbers), ("assessed", pa.bool_()), *texts])
        parquet.write_table(pa.Table.from_pylist(self._rows, schema=schema), path)


def _known(value: float) -> float | None:
    return None if np.isnan(value) else value
