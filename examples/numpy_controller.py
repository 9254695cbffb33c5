"""A controller with nothing but numpy
===================================

A whole controller in numpy alone, on nothing but what the Gymnasium environment shows.

It reads the target's depth from the first maps, comes down on it from above, and stops when it feels something.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from laploop.envs import ReachEnv

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1000, help="control periods of 8 ms at most")
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()

FOCAL = 128.0 / np.tan(np.deg2rad(30.0))  # pixels: 256 of them span 60 degrees
BALL = 0.0015  # metres, radius of the tool's tip


def point_under(pixel, observation):
    """Return the point of the tissue that a pixel shows, in metres along the camera's axes."""
    column, row = int(pixel[0]), int(pixel[1])
    around = np.s_[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4]
    depth = observation["depth_mm"][around][observation["depth_valid"][around] == 1]
    z = float(np.median(depth)) * 1e-3
    return np.array([(pixel[0] - 128.0) / FOCAL * z, (pixel[1] - 128.0) / FOCAL * z, z])


env = ReachEnv(perception="phase")
observation, info = env.reset(seed=options.seed)
target = point_under(observation["target_pixel"], observation)
goal = target - [0.0, 0.0, BALL]
above = goal - [0.0, 0.0, 0.020]
arrived = False
path = []

for _ in range(options.steps):
    path.append(observation["tip_position"] - goal)
    tip, force = observation["tip_position"], np.linalg.norm(observation["contact_force"])
    arrived = arrived or np.linalg.norm(above - tip) < 0.002
    if not arrived:
        velocity = 3.0 * (above - tip)
    else:
        # Across it stays over the target; down it goes until 0.05 N are felt, 10 mm/s at most.
        down = 0.1 * (0.05 - force)
        velocity = np.append(3.0 * (goal - tip)[:2], np.clip(down, -0.02, 0.01))
    velocity *= min(1.0, 0.05 / max(np.linalg.norm(velocity), 1e-9))
    observation, reward, terminated, truncated, info = env.step(velocity.astype(np.float32))
    if terminated or truncated:
        break

print(f"ended by {info['terminated_by']} after {info['sim_s']:.2f} s, {info['target_error_mm']:.2f} mm from an ideal touch")
env.close()

times_s = 0.008 * np.arange(len(path))
figure, axis = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
axis.plot(times_s, 1e3 * np.array(path), label=["x, right", "y, down", "z, away"])
axis.set(xlabel="time, s", ylabel="tip from its goal, mm", title="The way down, along the camera's axes")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
