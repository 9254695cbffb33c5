"""A controller of your own
========================

Put a controller of your own into the loop: here, plain position-based visual servoing.

Anything with `reset()` and `command(state) -> velocity of the tip` will do. This one looks up the point under the target's
pixel in the newest depth map, takes the surface's normal from its neighbours, and drives at its place 3 mm above. It knows
nothing of outliers, late frames, forces, or its own shaft in the picture: compare it with the scripted controller.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from laploop.assets import ScopeOptics
from laploop.envs import EpisodeConfig, Recorder, run_episode
from laploop.perception import Rig

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1500, help="control periods of 8 ms")
parser.add_argument("--motion", default="still", choices=["still", "breathing", "beating", "both"])
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()


class VisualServo:
    """Velocity proportional to the way that is left, as Chaumette and Hutchinson's position-based servo has it."""

    gain_per_s = 3.0
    height_m = 0.003 + 0.0015

    def __init__(self):
        """Take the camera of the nominal scope."""
        self.camera = Rig.from_optics(ScopeOptics()).camera
        self.reset()

    def reset(self):
        """Forget the place."""
        self.goal = None

    def command(self, state):
        """Return the velocity of the tip in m/s, along the camera's axes."""
        if state.depth is not None:
            self.look(state.depth.estimate, state.target_pixel)
        if self.goal is None:
            return np.zeros(3)
        return np.clip(self.gain_per_s * (self.goal - state.tip_in_camera), -0.04, 0.04)

    def look(self, estimate, pixel):
        """Put the goal above the point under the pixel, if that and its neighbours are valid."""
        column, row = int(pixel[0]), int(pixel[1])
        spots = [(row, column), (row, column + 6), (row + 6, column)]
        if all(0 <= r < self.camera.height and 0 <= c < self.camera.width and estimate.valid[r, c] for r, c in spots):
            here, right, down = (self.camera.rays[r, c] * estimate.depth_mm[r, c] * 1e-3 for r, c in spots)
            normal = np.cross(down - here, right - here)
            self.goal = here + self.height_m * normal / np.linalg.norm(normal)


class Errors(Recorder):
    """Keeps the tip's distance from its place, a value a control tick."""

    def begin(self, theatre, rig):  # noqa: ARG002  the recorders' signature
        """Forget earlier episodes."""
        self.times_s, self.errors_mm = [], []

    def tick(self, record):
        """Take a control tick."""
        self.times_s.append(record.now_ns * 1e-9)
        self.errors_mm.append(record.target_error_mm)


config = EpisodeConfig.of(task="track", perception="phase", motion=options.motion, seed=1, seconds=options.steps * 0.008 + 0.1)
figure, axis = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
for name, controller in (("visual servo", VisualServo()), ("scripted", None)):
    errors = Errors()
    summary = run_episode(config, controller=controller, recorder=errors)
    error, force = summary["target_error_mm"]["final"], summary["contact_force_n"]["max"]
    print(f"{name:13s} {error:6.2f} mm off its place at the end, at most {force:.2f} N")
    axis.semilogy(errors.times_s, errors.errors_mm, label=name)
axis.set(xlabel="time, s", ylabel="distance from its place, mm", title=f"Tissue: {options.motion}")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
