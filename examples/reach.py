"""The loop, step by step
======================

Close the loop by hand: stripes to depth to a trocar-constrained reach, in Gymnasium's terms.

Run it with `python examples/reach.py`; `--steps 50` stops early, `--motion breathing` lets the tissue move.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from laploop.control import ReachController
from laploop.envs import EpisodeConfig, ReachEnv

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1500, help="control periods of 8 ms at most")
parser.add_argument("--seed", type=int, default=1)
parser.add_argument("--motion", default="still", choices=["still", "breathing", "beating", "both"])
parser.add_argument("--perception", default="compact")
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()

# The environment renders stripes, has the network turn each frame into depth, and delivers the depth 40 ms later.
config = EpisodeConfig.of(task="reach", motion=options.motion, seconds=12.0).task
env = ReachEnv(config, perception=options.perception)
observation, info = env.reset(seed=options.seed)
print(f"target pixel {observation['target_pixel']}, depth is {info['depth_age_ms']:.0f} ms old at the start")

# The scripted controller sees what a controller on the real robot would see, and answers with a velocity of the tip.
controller = ReachController(env.loop.rig)
controller.reset()
times_s, errors_mm, forces_n = [], [], []

for step in range(options.steps):
    velocity = controller.command(env.control_input())
    observation, reward, terminated, truncated, info = env.step(velocity.astype(np.float32))
    times_s.append(info["sim_s"])
    errors_mm.append(info["target_error_mm"])
    forces_n.append(info["contact_force_n"])
    if step % 50 == 0:
        print(f"{info['sim_s']:5.2f} s  error {info['target_error_mm']:6.2f} mm  force {info['contact_force_n']:.2f} N")
    if terminated or truncated:
        break

print(f"ended by {info['terminated_by']} after {info['sim_s']:.2f} s, {info['target_error_mm']:.2f} mm from an ideal touch")
env.close()

figure, (above, below) = plt.subplots(2, figsize=(7.0, 4.5), sharex=True, layout="constrained")
above.semilogy(times_s, errors_mm)
above.set(ylabel="from an ideal touch, mm", title="Reach")
below.plot(times_s, forces_n)
below.set(xlabel="time, s", ylabel="contact force, N")
if options.picture:
    figure.savefig(options.picture)
