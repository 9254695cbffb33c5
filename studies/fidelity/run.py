"""What the fidelity `fast` changes, against `full`: the same motion of the tool on the same tissue, and the same task."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.control.arm.model import ArmModel
from laploop.control.arm.rcm_controller import RcmController
from laploop.envs.episode import run_episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.fidelity import FidelityName, with_fidelity
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.ray_camera import RayCamera
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.geometry import Rig
from laploop.studies.fidelity.config import FidelityConfig

NAMES: tuple[FidelityName, ...] = ("full", "fast")
_FRAME_TICKS = 5
"""Control periods between two depth images."""
_LEGS = (
    ("lower", (0.0, 0.0, -0.020)),
    ("hold", (0.0, 0.0, 0.0)),
    ("slide", (-0.010, 0.004, 0.0)),
)
"""What the tool does: velocity of its tip in the world, m/s; it is lowered until the tissue at rest is pressed."""
_LEG_S = 1.0
"""Duration of holding and of sliding."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _History:
    """What one theatre did, a row a control period."""

    force_n: Array
    """(ticks,)."""
    surface: Array
    """(ticks, n, 3), metres: vertices of the tissue's top."""
    depth_mm: Array
    """(frames, height, width), exact; NaN off the tissue."""


def measure_fidelity(config: FidelityConfig, progress: Callable[[float], None] | None = None) -> dict[str, Any]:
    """Press every tissue at both fidelities by the same joint commands, and run the same episodes.

    Args:
        config: What to do.
        progress: Called with the number of tissues done.

    Returns:
        `seeds`, a row each; `overall`, the root mean square or the worst over them; and `episodes` by fidelity.
    """
    report = progress or (lambda _done: None)
    rows: list[dict[str, Any]] = []
    episodes: dict[str, list[Mapping[str, Any]]] = {name: [] for name in NAMES}
    for done, seed in enumerate(range(config.first_seed, config.first_seed + config.seeds)):
        report(done)
        episode = EpisodeConfig.of(perception=config.perception, motion=config.motion, seed=seed)
        rows.append({"seed": seed, **_compare(*_histories(episode, config))})
        for name in NAMES:
            episodes[name].append(run_episode(episode.changed(fidelity=name)))
    report(config.seeds)
    return {
        "seeds": rows,
        "overall": _overall(rows),
        "episodes": {name: _episodes(found) for name, found in episodes.items()},
    }


def _histories(episode: EpisodeConfig, config: FidelityConfig) -> tuple[_History, _History]:
    commands: list[tuple[Array, Array]] = []
    full, fast = (_press(episode.changed(motion="still"), name, config, commands) for name in NAMES)
    return full, fast


def _press(
    episode: EpisodeConfig, fidelity: FidelityName, config: FidelityConfig, commands: list[tuple[Array, Array]]
) -> _History:
    """Play the commands to a tissue; the first time, when there are none, work them out."""
    loop = with_fidelity(episode.task, fidelity).loop
    theatre = Theatre(loop.theatre, loop, seed=episode.seed)
    if not commands:
        commands += _commands(theatre, loop.control_s, config.press_m)
    rig = Rig.from_optics(loop.theatre.scope)
    camera = RayCamera(rig)
    camera.attach(theatre.model, tissue=theatre.tissue)
    forces: list[float] = []
    surfaces: list[Array] = []
    depths: list[Array] = []
    for tick, (q, qdot) in enumerate(commands):
        theatre.set_joint_targets(theatre.tool_arm, q, qdot)
        for _ in range(theatre.rates.physics_steps_per_control):
            theatre.step()
        forces.append(float(np.linalg.norm(theatre.log.contact_force.mean(axis=0))))
        surfaces.append(theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count])
        if tick % _FRAME_TICKS == 0:
            view = camera.exact(theatre.data, theatre.world_from_camera())
            depths.append(np.where(view.object_id == ObjectId.TISSUE, view.depth_mm, np.nan))
    return _History(force_n=np.array(forces), surface=np.array(surfaces), depth_mm=np.array(depths))


def _commands(theatre: Theatre, period_s: float, press_m: float) -> list[tuple[Array, Array]]:
    """Return joint angles and speeds of every control period."""
    arm = theatre.tool_arm
    controller = RcmController(ArmModel(arm.world_from_base, arm.shaft), arm.trocar_in_world)
    controller.reset(arm.home_q)
    tip = theatre.tip_in_world()
    points = theatre.tissue.surface_points()[: theatre.tissue.top_vertex_count]
    under = points[np.linalg.norm(points[:, :2] - tip[:2], axis=1) < arm.shaft.tip_radius_m, 2].max()
    way = float(tip[2] - arm.shaft.tip_radius_m - under) + press_m
    commands = []
    for name, velocity in _LEGS:
        duration_s = way / abs(velocity[2]) if name == "lower" else _LEG_S
        commands += [controller.step(np.array(velocity), period_s) for _ in range(round(duration_s / period_s))]
    return commands


def _compare(full: _History, fast: _History) -> dict[str, float]:
    touched = full.force_n > 0.0
    apart_mm = 1e3 * np.linalg.norm(fast.surface - full.surface, axis=2)
    depth_mm = np.abs(fast.depth_mm - full.depth_mm)
    return {
        "force_full_n": float(full.force_n[touched].mean()),
        "force_fast_n": float(fast.force_n[touched].mean()),
        "force_rms_n": float(np.sqrt(np.mean((fast.force_n - full.force_n)[touched] ** 2))),
        "surface_rms_mm": float(np.sqrt(np.mean(apart_mm[touched] ** 2))),
        "surface_worst_mm": float(apart_mm.max()),
        "depth_mae_mm": float(np.nanmean(depth_mm)),
        "depth_p99_mm": float(np.nanpercentile(depth_mm, 99.0)),
    }


def _overall(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Return the mean forces, the root mean squares and the worst of all tissues."""
    found: dict[str, float] = {}
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        if name.endswith(("_rms_n", "_rms_mm")):
            found[name] = float(np.sqrt(np.mean(values**2)))
        elif name.endswith(("_worst_mm", "_p99_mm")):
            found[name] = float(values.max())
        elif name != "seed":
            found[name] = float(values.mean())
    return found


def _episodes(summaries: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    errors = [summary["target_error_mm"]["final"] for summary in summaries]
    return {
        "episodes": len(summaries),
        "success_rate": float(np.mean([summary["success"] for summary in summaries])),
        "final_error_mm": float(np.mean(errors)),
        "sim_s": float(np.mean([summary["sim_s"] for summary in summaries])),
        "max_force_n": float(max(summary["contact_force_n"]["max"] for summary in summaries)),
    }


def as_markdown(result: Mapping[str, Any]) -> str:
    """Return the differences as two tables."""
    overall, episodes = result["overall"], result["episodes"]
    lines = [
        "| the same commands, while the tip touches | |",
        "|---|---|",
        f"| force, mean, `full` and `fast` | {overall['force_full_n']:.3f} and {overall['force_fast_n']:.3f} N |",
        f"| difference of force, RMS | {overall['force_rms_n']:.3f} N |",
        f"| difference of the surface, RMS | {overall['surface_rms_mm']:.3f} mm |",
        f"| difference of the surface, worst vertex | {overall['surface_worst_mm']:.2f} mm |",
        f"| difference of exact depth, mean | {overall['depth_mae_mm']:.4f} mm |",
        f"| difference of exact depth, 99th percentile, worst tissue | {overall['depth_p99_mm']:.3f} mm |",
        "",
        "| the same task | success | final error, mean | force, worst |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| `{name}`, {one['episodes']} episodes | {100 * one['success_rate']:.0f} % | {one['final_error_mm']:.2f} mm | "
        f"{one['max_force_n']:.2f} N |"
        for name, one in episodes.items()
    ]
    return "\n".join([*lines, ""])
