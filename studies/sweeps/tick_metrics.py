"""What a study measures of an episode: accuracy, forces and ages from its control ticks."""

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.tasks.configs import ReachConfig

METRICS = {
    "normal_rms_mm": "RMS error along the normal [mm]",
    "normal_p95_mm": "95th percentile of the error along the normal [mm]",
    "lateral_rms_mm": "RMS error across the normal [mm]",
    "lateral_p95_mm": "95th percentile of the error across the normal [mm]",
    "total_rms_mm": "RMS error [mm]",
    "total_p95_mm": "95th percentile of the error [mm]",
    "time_to_target_s": "time to target [s]",
    "force_mean_n": "mean contact force [N]",
    "force_max_n": "worst contact force [N]",
    "depth_age_mean_ms": "mean age of depth [ms]",
    "depth_age_p99_ms": "99th percentile of the age of depth [ms]",
    "dropped_frames": "dropped frames",
    "final_error_mm": "final error [mm]",
    "port_force_n": "worst force at a trocar [N]",
    "depth_mae_mm": "mean absolute error of depth [mm]",
    "depth_valid_fraction": "valid fraction of the depth",
    "success": "success",
    "overshoot_percent": "overshoot [%]",
    "growth_per_s": "growth rate [1/s]",
}
"""What a sweep may show, and its label in figures; an episode has those that its task gives meaning to."""

AT_TARGET_MM = ReachConfig.success_radius_m * 1e3
"""Error within which the tip counts as at its target."""


def tick_metrics(
    *,
    time_s: Array,
    along_mm: Array,
    across_mm: Array,
    assessed: NDArray[np.bool_],
    force_n: Array,
    age_ms: Array,
) -> dict[str, float | None]:
    """Measure an episode.

    Args:
        time_s: (n,), times of the control ticks.
        along_mm: (n,), error along the surface's normal, or the optical axis where the camera moves.
        across_mm: (n,), magnitude of the error across it.
        assessed: (n,), whether a tick counts for accuracy.
        force_n: (n,), worst contact force of each control period.
        age_ms: (n,), age of the newest depth; NaN before the first.

    Returns:
        By name: root mean squares and 95th percentiles of the errors' magnitudes over the assessed ticks; from the first tick
        to the first one at the target; forces of all ticks; ages. None for what no tick shows.
    """
    total_mm = np.hypot(along_mm, across_mm)
    parts = {"normal": np.abs(along_mm), "lateral": across_mm, "total": total_mm}
    found: dict[str, float | None] = {}
    for name, error_mm in parts.items():
        counted = error_mm[assessed]
        found[f"{name}_rms_mm"] = float(np.sqrt(np.mean(counted**2))) if counted.size else None
        found[f"{name}_p95_mm"] = float(np.percentile(counted, 95)) if counted.size else None
    there = np.flatnonzero(total_mm <= AT_TARGET_MM)
    ages_ms = age_ms[np.isfinite(age_ms)]
    return {
        **found,
        "time_to_target_s": float(time_s[there[0]] - time_s[0]) if there.size else None,
        "force_mean_n": float(np.mean(force_n)) if force_n.size else None,
        "force_max_n": float(np.max(force_n)) if force_n.size else None,
        "depth_age_mean_ms": float(np.mean(ages_ms)) if ages_ms.size else None,
        "depth_age_p99_ms": float(np.percentile(ages_ms, 99)) if ages_ms.size else None,
    }
