"""A motion predictor of your own
==============================

Predict the tissue's motion yourself: here, with a parabola through what was seen in the last quarter of a second.

Anything with `reset`, `update(measured, captured_ns)` and `predict(at_ns)` will do. The displacement is in metres along the
optical axis, times are integer nanoseconds, and measurements come late by the age of their frame.
"""

import argparse
from collections import deque

import matplotlib.pyplot as plt
import numpy as np

from laploop.assets import ScopeOptics
from laploop.control import Prediction, make_controller
from laploop.envs import EpisodeConfig, Recorder, run_episode
from laploop.perception import Rig

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1875, help="control periods of 8 ms")
parser.add_argument("--motion", default="both", choices=["still", "breathing", "beating", "both"])
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()


class Parabola:
    """Least squares over the newest measurements; trusted as soon as there are enough of them."""

    def __init__(self):
        """Start without measurements."""
        self.seen = deque(maxlen=7)

    def reset(self):
        """Forget everything."""
        self.seen.clear()

    def update(self, measured, captured_ns):
        """Take in a displacement, None if nothing was measured; return whether it is accepted."""
        if measured is not None:
            self.seen.append((captured_ns, measured))
        return measured is not None

    def predict(self, at_ns):
        """Return the displacement and its velocity at a time."""
        if len(self.seen) < self.seen.maxlen:
            # Until it is trusted, the tissue is taken to go on at the rate measured last.
            return Prediction(value=0.0, velocity=0.0, trusted=False)
        times = np.array([captured_ns - at_ns for captured_ns, _ in self.seen]) * 1e-9
        _, velocity, value = np.polyfit(times, [measured for _, measured in self.seen], 2)
        return Prediction(value=float(value), velocity=float(velocity), sigma=0.0005, trusted=True)


class Errors(Recorder):
    """Keeps the tip's distance from its place, a value a control tick."""

    def begin(self, theatre, rig):  # noqa: ARG002  the recorders' signature
        """Forget earlier episodes."""
        self.times_s, self.errors_mm = [], []

    def tick(self, record):
        """Take a control tick."""
        self.times_s.append(record.now_ns * 1e-9)
        self.errors_mm.append(record.target_error_mm)


rig = Rig.from_optics(ScopeOptics())
config = EpisodeConfig.of(task="track", perception="phase", motion=options.motion, seed=1, seconds=options.steps * 0.008 + 0.1)
figure, axis = plt.subplots(figsize=(7.0, 3.5), layout="constrained")
for name, predictor in (("parabola", Parabola()), ("rhythms", "rhythms")):
    errors = Errors()
    summary = run_episode(config, controller=make_controller("track", rig, prediction=predictor), recorder=errors)
    # Tracking is judged from 10 s on, when the rhythms have been learnt.
    rms = summary["metrics"]["normal_rms_mm"]
    print(f"{name:9s} error along the normal:", "not judged, too short" if rms is None else f"{rms:.3f} mm root mean square")
    axis.semilogy(errors.times_s, errors.errors_mm, label=name)
axis.set(xlabel="time, s", ylabel="distance from its place, mm", title=f"Tissue: {options.motion}")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
