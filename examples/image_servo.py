"""Delay in a visual loop
======================

See what delay does to a loop that is closed through the camera, and what a Smith predictor gives back.

The scope looks at a point of tissue that breathes and travels. A plain image-based servo knows the target's place in the newest
frame alone. From pi/2 divided by its gain on, delay makes it swing ever wider; the Smith predictor adds what its own commands
should have done since the frame was taken.
"""

import argparse

import matplotlib.pyplot as plt

from laploop.control import ImageServoConfig, ImageServoController
from laploop.envs import EpisodeConfig, Recorder, run_episode
from laploop.perception import Rig

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1000, help="control periods of 8 ms")
parser.add_argument(
    "--delay-ms", type=float, default=300.0, help="from the capture of a frame to its use, 40 ms of it perception"
)
parser.add_argument("--gain", type=float, default=4.0, help="per second")
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()


class Errors(Recorder):
    """Keeps how far the target is off the middle, a value a control tick."""

    def begin(self, theatre, rig):  # noqa: ARG002  the recorders' signature
        """Forget earlier episodes."""
        self.times_s, self.errors_mm = [], []

    def tick(self, record):
        """Take a control tick."""
        self.times_s.append(record.now_ns * 1e-9)
        self.errors_mm.append(record.target_error_mm)


config = EpisodeConfig.of(
    task="look",
    perception="oracle",
    seed=1,
    seconds=options.steps * 0.008 + 0.1,
    transfer_latency_ms=max(options.delay_ms - 40.0, 0.0),
)
rig = Rig.from_optics(config.task.loop.theatre.scope)
figure, axis = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
for name, compensation in (("plain", "none"), ("Smith predictor", "smith")):
    servo = ImageServoController(rig, ImageServoConfig(gain_per_s=options.gain, compensation=compensation))
    errors = Errors()
    error = run_episode(config, controller=servo, recorder=errors)["target_error_mm"]
    print(f"{name:15s} {error['mean']:6.2f} mm off the middle on average, {error['p95']:6.2f} mm at worst 5 %")
    axis.plot(errors.times_s, errors.errors_mm, label=name)
axis.set(xlabel="time, s", ylabel="distance from the middle, mm", title=f"{options.delay_ms:g} ms of delay")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
