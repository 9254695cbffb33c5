"""One frame, from stripes to depth
================================

Take a single frame of the theatre and look at what each depth estimator makes of it.

The environment is reset, nothing moves. Its first frame goes to estimators by name; the classical one leaves out what it
cannot read, the network says something everywhere and marks what it trusts.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from laploop.envs import ReachEnv
from laploop.perception import make_estimator

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1, help="control periods before the frame is taken")
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()

env = ReachEnv(perception="oracle")
observation, info = env.reset(seed=options.seed)
for _ in range(options.steps):
    observation, *_ = env.step(np.zeros(3, np.float32))
stripes, exact_mm = observation["stripes"], observation["depth_mm"]
seen = observation["depth_valid"] == 1
rig = env.loop.rig
env.close()

figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.4), layout="constrained")
axes[0].imshow(stripes, cmap="gray", vmin=0, vmax=255)
axes[0].set_title("stripes")
shown = axes[1].imshow(np.where(seen, exact_mm, np.nan))
axes[1].set_title("exact depth")
for axis, name in zip(axes[2:], ("phase", "compact"), strict=True):
    estimate = make_estimator(name, rig).estimate(stripes)
    both = seen & estimate.valid
    error_mm = np.abs(estimate.depth_mm - exact_mm)[both]
    print(f"{name:8s} valid on {100 * both.sum() / seen.sum():.0f} % of what is seen, {error_mm.mean():.2f} mm off on average")
    axis.imshow(np.where(both, estimate.depth_mm, np.nan), clim=shown.get_clim())
    axis.set_title(f"{name}, where valid")
for axis in axes:
    axis.set(xticks=[], yticks=[])
figure.colorbar(shown, ax=axes, label="depth, mm")
if options.picture:
    figure.savefig(options.picture)
