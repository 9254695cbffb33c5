"""What observations hold.

| key | space | modes | meaning |
|---|---|---|---|
| `stripes` | `Box(0, 255, (256, 256), uint8)` | all, stripes | newest image that has arrived from the camera |
| `depth_mm` | `Box(0, 250, (256, 256), float32)` | all, depth | newest depth map that has arrived; 0 where it is not valid |
| `depth_valid` | `Box(0, 1, (256, 256), uint8)` | all, depth | where the estimator marks its depth valid |
| `depth_age_s` | `Box(0, 10, (1,), float32)` | all, depth | time since that map's frame was captured, by its time stamp |
| `tip_position` | `Box(-1, 1, (3,), float32)` | every | tool tip in the camera's frame, m |
| `tip_velocity` | `Box(-1, 1, (3,), float32)` | every | its velocity, m/s |
| `contact_force` | `Box(-50, 50, (3,), float32)` | every | force on the tip along the camera's axes, N |
| `target_pixel` | `Box(0, 256, (2,), float32)` | every | chosen pixel (u, v) of the first frame, centres at +0.5 |
| `target_position` | `Box(-1, 1, (3,), float32)` | state | true target point now in the camera's frame, m |
| `target_normal` | `Box(-1, 1, (3,), float32)` | state | true normal of the tissue there, towards the outside |

A task adds keys of its own in every mode. `state` is the simulator's truth, for learning without images.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from laploop.envs.loop.perception_server import ServedFrame
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.tasks.task_config import DEPTH_MODES, STRIPE_MODES, ObservationMode

Observation = dict[str, Any]

MAX_DEPTH_MM = 250.0
"""Largest depth that an observation shows."""
MAX_AGE_S = 10.0
MAX_FORCE_N = 50.0


def observation_space(mode: ObservationMode, size: tuple[int, int], extra: dict[str, spaces.Box]) -> spaces.Dict:
    """Return the space of a mode with images of `size`, height and width, and with the task's own keys."""
    found: dict[str, spaces.Space[Any]] = {}
    if mode in STRIPE_MODES:
        found["stripes"] = spaces.Box(0, 255, size, np.uint8)
    if mode in DEPTH_MODES:
        found["depth_mm"] = spaces.Box(0.0, MAX_DEPTH_MM, size, np.float32)
        found["depth_valid"] = spaces.Box(0, 1, size, np.uint8)
        found["depth_age_s"] = spaces.Box(0.0, MAX_AGE_S, (1,), np.float32)
    found["tip_position"] = spaces.Box(-1.0, 1.0, (3,), np.float32)
    found["tip_velocity"] = spaces.Box(-1.0, 1.0, (3,), np.float32)
    found["contact_force"] = spaces.Box(-MAX_FORCE_N, MAX_FORCE_N, (3,), np.float32)
    found["target_pixel"] = spaces.Box(0.0, float(max(size)), (2,), np.float32)
    if mode == "state":
        found["target_position"] = spaces.Box(-1.0, 1.0, (3,), np.float32)
        found["target_normal"] = spaces.Box(-1.0, 1.0, (3,), np.float32)
    return spaces.Dict({**found, **extra})


def depth_observation(served: ServedFrame, now_ns: int) -> Observation:
    """Return the keys of a depth map."""
    estimate = served.depth.estimate
    return {
        "depth_mm": np.where(estimate.valid, np.clip(estimate.depth_mm, 0.0, MAX_DEPTH_MM), np.float32(0.0)),
        "depth_valid": estimate.valid.astype(np.uint8),
        "depth_age_s": bounded([served.depth.age_ns(now_ns) * 1e-9], 0.0, MAX_AGE_S),
    }


def depth_quality(served: ServedFrame) -> tuple[float, float]:
    """Return mean absolute error in mm and fraction of valid pixels, both on the tissue that the frame shows."""
    truth = served.captured.depth
    tissue = truth.object_id == ObjectId.TISSUE
    valid = tissue & served.depth.estimate.valid
    errors = np.abs(served.depth.estimate.depth_mm[valid] - truth.depth_mm[valid])
    mae_mm = float(errors.mean()) if errors.size else float("nan")
    return mae_mm, float(valid.sum() / max(1, tissue.sum()))


def bounded(values: Any, low: float, high: float) -> NDArray[np.float32]:
    """Return values as float32 within bounds."""
    return np.clip(np.asarray(values, dtype=np.float32), np.float32(low), np.float32(high))
