"""An estimator of your own
========================

Put an estimator of your own into the loop: here, one that smooths the depth of the classical phase method.

Anything with `estimate(image) -> DepthEstimate` will do. Registered under a name, it can be used wherever a name is taken. A
package of your own registers it by an entry point in the group `laploop.estimators`; then the command line knows it too, as it
knows `module:Class`: `laploop evaluate --models phase my_module:SmoothedPhase ...`.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

from laploop.envs import EpisodeConfig, Recorder, run_episode
from laploop.perception import ESTIMATORS, DepthEstimate, make_estimator

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1250, help="control periods of 8 ms at most")
parser.add_argument("--picture", help="file to save the figure to")
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


class FirstDepth(Recorder):
    """Keeps the error of the first depth map that arrives."""

    error_mm = None

    def depth(self, record):
        """Take a depth map with the truth of its moment."""
        if self.error_mm is None:
            self.error_mm = record.error_mm()


ESTIMATORS.register("smoothed-phase", SmoothedPhase)
figure, axes = plt.subplots(1, 2, figsize=(8.0, 3.6), layout="constrained")
for axis, name in zip(axes, ("phase", "smoothed-phase"), strict=True):
    first = FirstDepth()
    config = EpisodeConfig.of(perception=name, seed=1, seconds=options.steps * 0.008 + 0.04)
    summary = run_episode(config, recorder=first)
    print(
        f"{name:15s} depth error {summary['depth_mae_mm']:.2f} mm, ended by {summary['terminated_by']}, "
        f"{summary['target_error_mm']['final']:.2f} mm from an ideal touch"
    )
    shown = axis.imshow(first.error_mm, cmap="RdBu", vmin=-3.0, vmax=3.0)
    axis.set(title=name, xticks=[], yticks=[])
figure.colorbar(shown, ax=axes, label="depth error, mm; white is none or not valid")
if options.picture:
    figure.savefig(options.picture)
