"""What late depth costs
=====================

Follow breathing tissue with depth that comes later and later, with and without prediction.

A follower that repeats what it saw a time t ago is off by a sine of amplitude 2 A sin(pi f t), for a motion of amplitude A and
frequency f: the dashed line. Without prediction the controller is off by that and by what its own gain leaves; a predictor
that has learned the breathing does away with both.
"""

import argparse

import matplotlib.pyplot as plt
import numpy as np

from laploop.envs import EpisodeConfig, run_episode

parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
parser.add_argument("--steps", type=int, default=1750, help="control periods of 8 ms; the first 10 s are not judged")
parser.add_argument("--delays-ms", type=float, nargs="+", default=[0.0, 100.0, 200.0], help="added to the transfer of frames")
parser.add_argument("--picture", help="file to save the figure to")
options = parser.parse_args()

figure, axis = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
for prediction in ("none", "rhythms"):
    ages_ms, rms_mm = [], []
    for delay_ms in options.delays_ms:
        config = EpisodeConfig.of(
            task="track",
            perception="oracle",
            motion="breathing",
            prediction=prediction,
            transfer_latency_ms=delay_ms,
            seed=3,
            seconds=options.steps * 0.008,
        )
        summary = run_episode(config)
        ages_ms.append(summary["depth_age_ms"]["mean"])
        rms_mm.append(summary["metrics"]["normal_rms_mm"] or np.nan)
        print(f"{prediction:8s} depth {ages_ms[-1]:4.0f} ms old, {rms_mm[-1]:.3f} mm off along the normal (root mean square)")
    axis.plot(ages_ms, rms_mm, "o-", label=f"prediction: {prediction}")
# 10 mm from peak to peak at 0.25 Hz; the root mean square of a sine is its amplitude over the square root of two.
axis.plot(ages_ms, np.sqrt(2.0) * 5.0 * np.sin(np.pi * 0.25 * 1e-3 * np.array(ages_ms)), "k--", label="pure delay")
axis.set(xlabel="mean age of the newest depth, ms", ylabel="error along the normal, mm RMS")
axis.legend()
if options.picture:
    figure.savefig(options.picture)
