"""Put an estimator of your own into the loop: here, one that smooths what the classical phase method says.

Anything with `estimate(image) -> DepthEstimate` will do; nothing else of laploop needs to know about it.
"""

import argparse

import numpy as np
from scipy import ndimage

from laploop.assets import ScopeOptics
from laploop.envs import EpisodeConfig, run_episode
from laploop.perception import DepthEstimate, Rig, make_estimator

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=1250, help="control periods of 8 ms at most")
options = parser.parse_args()


class SmoothedPhase:
    """Phase demodulation followed by a median over 5x5 pixels."""

    def __init__(self):
        """Wrap the classical estimator for the nominal rig."""
        self.phase = make_estimator("phase", Rig.from_optics(ScopeOptics()))

    def estimate(self, image):
        """Return the smoothed depth of one stripe image."""
        raw = self.phase.estimate(image)
        depth_mm = ndimage.median_filter(raw.depth_mm, size=5)
        return DepthEstimate(depth_mm=depth_mm.astype(np.float32), valid=raw.valid)


config = EpisodeConfig(perception="phase", seed=1, seconds=options.steps * 0.008 + 0.04)
for name, estimator in (("phase", None), ("smoothed phase", SmoothedPhase())):
    summary = run_episode(config, estimator=estimator)
    print(
        f"{name:15s} depth error {summary['depth_mae_mm']:.2f} mm, ended by {summary['terminated_by']}, "
        f"{summary['target_error_mm']['final']:.2f} mm from an ideal touch"
    )
