"""What can be known of a depth frame's measurement before the frame has come."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.control.targeting.depth_sampler import Places

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePrediction:
    """Where the followed points should appear in a frame, and which of them the tool leaves in sight."""

    captured_ns: int
    tip: Array | None
    trocar: Array
    """(3,), the tool's two ends at that time; no tip if it is not known."""
    displacement: float
    """Along the reference's optical axis, metres."""
    axis: Array
    """(3,), that axis in the frame's camera."""
    points: Array
    """(3, n), the points in the frame's camera."""
    in_sight: NDArray[np.bool_]
    """(n,)."""
    places: Places

    def holds(self, captured_ns: int, tip: Array | None, trocar: Array) -> bool:
        """Say whether a frame that has come is the expected one, and nothing is known better by now."""
        return self.captured_ns == captured_ns and self.tip is tip and bool(self.trocar.tolist() == trocar.tolist())
