"""A target of your own
====================

Choose the target yourself: here, the top of the tissue, which a surgeon would reach without passing anything else.

A selector is any function from a depth map to a pixel. The environment shows the first frame, the selector answers, and the
same theatre begins anew with that pixel as its target.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

from laploop.control import ReachController
from laploop.envs import ReachEnv

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1000, help="control periods of 8 ms at most")
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()


def top_of_the_tissue(depth_mm, valid):
    """Return (column, row) of the middle of the nearest patch, well inside the view."""
    far = np.where(valid, depth_mm, 250.0)
    smooth = ndimage.uniform_filter(ndimage.median_filter(far, size=5), size=9)
    inside = np.full(smooth.shape, np.inf)
    inside[64:-64, 64:-64] = smooth[64:-64, 64:-64]
    row, column = np.unravel_index(np.argmin(inside), inside.shape)
    return int(column), int(row)


env = ReachEnv(perception="phase")
observation, info = env.reset(seed=options.seed)
pixel = top_of_the_tissue(observation["depth_mm"], observation["depth_valid"].astype(bool))
print(f"the environment would take {observation['target_pixel']}, the selector takes {pixel}")

figure, axis = plt.subplots(figsize=(4.5, 4.0), layout="constrained")
shown = axis.imshow(np.where(observation["depth_valid"] == 1, observation["depth_mm"], np.nan))
axis.plot(*pixel, "r+", markersize=14)
axis.set(title="The selector's choice", xticks=[], yticks=[])
figure.colorbar(shown, label="depth, mm")

observation, info = env.reset(seed=options.seed, options={"target_pixel": pixel})
controller = ReachController(env.loop.rig)
for _ in range(options.steps):
    velocity = controller.command(env.control_input())
    observation, reward, terminated, truncated, info = env.step(velocity.astype(np.float32))
    if terminated or truncated:
        break
print(f"ended by {info['terminated_by']} after {info['sim_s']:.2f} s, {info['target_error_mm']:.2f} mm from an ideal touch")
env.close()
if options.picture:
    figure.savefig(options.picture)
