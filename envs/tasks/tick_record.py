"""What a task hands its recorder at a control tick."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from laploop.arrays import Array
from laploop.assets.shafts import INSTRUMENT
from laploop.envs.recording.recorder import TickRecord

if TYPE_CHECKING:
    from laploop.envs.tasks.task_env import TaskEnv


def off_goal(env: "TaskEnv[Any]") -> tuple[Array, float, float]:
    """Return the goal, where the tool's tip touches the true target, (3,) metres in the world, and how far the tip is from it.

    The distances, in millimetres, are that along the target's normal, outwards positive, and that across it.
    """
    offset, normal, target = env.target_offset()
    off = offset - INSTRUMENT.tip_radius_m * normal
    along = float(off @ normal)
    return target + INSTRUMENT.tip_radius_m * normal, along * 1e3, float(np.linalg.norm(off - along * normal)) * 1e3


def tick_record(env: "TaskEnv[Any]", info: Mapping[str, Any], command: Array) -> TickRecord:
    """Gather the record of the control period that has just ended.

    Args:
        env: The task; its loop has come to the end of the period.
        info: What the task tells of the tick.
        command: (3,) m/s, the velocity of the moved tip that was asked for, along the camera's axes.
    """
    loop, theatre = env.loop, env.loop.theatre
    moved = theatre.camera_arm if env.moves_scope else theatre.tool_arm
    position_share, speed_share = loop.watch.joint_shares()
    goal, along, across = (None, None, None) if env.moves_scope else off_goal(env)
    return TickRecord(
        now_ns=loop.now_ns,
        target_error_mm=info["target_error_mm"],
        target_in_world=env.target_in_world(),
        rcm_error_mm=info["rcm_error_mm"],
        port_force_n=info["port_force_n"],
        contact_force_n=info["contact_force_n"],
        depth_age_ms=info["depth_age_ms"],
        stage_ms=loop.timer.lap_ms(),
        frame_ms=loop.timing_log.newest_ms(),
        command_mps=command,
        tip_velocity_mps=theatre.world_from_camera()[:3, :3].T @ theatre.tip_velocity_in_world(moved),
        goal_in_world=goal,
        off_goal_mm={} if along is None or across is None else {"along": along, "across": across},
        joint_position_share=position_share[theatre.arms.index(moved)],
        joint_speed_share=speed_share[theatre.arms.index(moved)],
        status=info["status"],
        status_reason=info["status_reason"],
        faults=", ".join(map(str, filter(None, [info["fault"], *info["injected_faults"]]))),
        reward_terms=info["reward_terms"],
        dropped_frames=info["dropped_frames"],
    )
