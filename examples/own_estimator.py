"""Put an estimator of your own into the loop: here, one that smooths the depth of the classical phase method.

Anything with `estimate(image) -> DepthEstimate` will do. Registered under a name, it can be used wherever a name is taken. A
package of your own registers it by an entry point in the group `laploop.estimators`; then the command line knows it too, as it
knows `module:Class`: `laploop evaluate --models phase my_module:SmoothedPhase ...`.
"""

import argparse

import numpy as np
from scipy import ndimage

from laploop.envs import EpisodeConfig, run_episode
from laploop.perception import ESTIMATORS, DepthEstimate, make_estimator

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=1250, help="control periods of 8 ms at most")
options = parser.parse_args()


class SmoothedPhase:
    """Phase demodulation followed by a median over 5x5 pixels."""

    def __init__(self, rig):
        """Wrap the classical estimator for a rig."""
        self.phase = make_estimator("phase", rig)

    def estimate(self, image):
        """Return the smoothed depth of one stripe image."""
        raw = self.phase.estimate(image)
        depth_mm = ndimage.median_filter(raw.depth_mm, size=5)
        return DepthEstimate(depth_mm=depth_mm.astype(np.float32), valid=raw.valid)


ESTIMATORS.register("smoothed-phase", SmoothedPhase)
for name in ("phase", "smoothed-phase"):
    summary = run_episode(EpisodeConfig.of(perception=name, seed=1, seconds=options.steps * 0.008 + 0.04))
    print(
        f"{name:15s} depth error {summary['depth_mae_mm']:.2f} mm, ended by {summary['terminated_by']}, "
        f"{summary['target_error_mm']['final']:.2f} mm from an ideal touch"
    )
