"""How long every stage of the loop takes alone, in this process."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from laploop.assets.scope_optics import ScopeOptics
from laploop.control.arm.rcm_controller import RcmController
from laploop.control.controllers.reach import ReachController
from laploop.envs.recording.recorder import ARM_NAMES, DepthRecord, FrameRecord, TickRecord
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.reference.camera import ReferenceCamera, lateral_mount
from laploop.envs.sensors.reference.optics import ReferenceOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import SimulationError
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig, invert_transform
from laploop.perception.messages import DepthFrame, StripeFrame
from laploop.perception.reprojection import reproject
from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.bench_result import Stage
from laploop.studies.timing.tick_times import kinematics_beside, tracking_tick_times

_WARM_UP_CALLS = 10
_PRESS_TICKS, _PRESS_MPS = 25, 0.005
"""The tip presses 1 mm deeper before physics in contact is measured: 25 control periods of 8 ms at 5 mm/s."""
_MOST_EPISODES = 50
_TOUCH_N = 0.01
_REFERENCE_CALLS = 10
"""Calls of the reference camera and of the reprojection, which take a thousand times as long as other stages."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Touch:
    """A theatre at the end of an episode, the tip on the tissue, and the durations of its control ticks."""

    env: ReachEnv
    rcm: RcmController
    """Where the tool's joint references are."""
    targeting_s: list[float]
    inverse_kinematics_s: list[float]


def stage_times(config: BenchConfig, report: Callable[[float], None]) -> list[Stage]:
    """Measure every stage; `report` is called with the fraction done, 0 to 1.

    Raises:
        SimulationError: If no episode brings the tip onto the tissue.
    """
    rig = Rig.from_optics(ScopeOptics())
    estimators = {name: make_estimator(name, rig) for name in config.estimators}
    touch = _reach_the_tissue(config)
    report(0.3)
    tracking, alone = tracking_tick_times(seed=config.seed, seconds=config.seconds)
    report(0.4)
    env = touch.env
    theatre = env.loop.theatre
    stages = [
        Stage.of("physics step, free", _time(Theatre(theatre.config, theatre.rates, seed=config.seed).step, config.calls)),
        Stage.of("physics step, in contact", _contact_physics(touch, config.calls)),
        Stage.of("control tick", np.add(touch.targeting_s, touch.inverse_kinematics_s)),
        Stage.of("control tick: targeting", touch.targeting_s),
        Stage.of("control tick: inverse kinematics", touch.inverse_kinematics_s),
        Stage.of("control tick: prediction", tracking.whole),
        Stage.of("control tick: kinematics, QP, prediction", tracking.core),
        Stage.of("control tick alone: prediction", alone.whole),
        Stage.of("control tick alone: kinematics, QP, prediction", alone.core),
    ]
    camera = StripeCamera(env.loop.rig, env.config.loop.optics, device=env.config.loop.device)
    camera.attach(theatre.model, tissue=theatre.tissue)
    rng = np.random.default_rng(config.seed)
    pose = theatre.world_from_camera()
    stages.append(Stage.of("stripe frame", _time(lambda: camera.capture(theatre.data, pose, rng), config.calls)))
    report(0.6)
    capture = camera.capture(theatre.data, pose, rng)
    for name, estimator in estimators.items():
        if isinstance(estimator, OracleEstimator):
            estimator.see_truth(capture.depth_mm)
        stages.append(Stage.of(f"depth: {name}", _time(partial(estimator.estimate, capture.image), config.calls)))
    report(0.75)
    stages += _reference_stages(theatre, env.loop.rig, rng)
    report(0.9)
    stages.append(Stage.of("recorder frame", _recorder_times(env, capture, config.calls)))
    env.close()
    report(1.0)
    return stages


def _reach_the_tissue(config: BenchConfig) -> _Touch:
    """Run episodes with exact depth until there are enough control ticks; return the last one, which ended in a touch."""
    targeting: list[float] = []
    kinematics: list[float] = []
    for number in range(_MOST_EPISODES):
        env = ReachEnv(ReachConfig(max_seconds=config.seconds), perception="oracle")
        controller = ReachController(env.loop.rig)
        env.reset(seed=config.seed + number)
        rcm = kinematics_beside(env)
        terminated = truncated = False
        info: dict[str, Any] = {}
        while not (terminated or truncated):
            velocity = _timed(targeting, controller.command, env.control_input())
            rotation = env.loop.theatre.world_from_camera()[:3, :3]
            _timed(kinematics, rcm.step, rotation @ velocity, env.config.loop.control_s)
            _, _, terminated, truncated, info = env.step(velocity.astype(np.float32))
        if info["success"] and len(targeting) >= config.calls:
            return _Touch(env=env, rcm=rcm, targeting_s=targeting, inverse_kinematics_s=kinematics)
        env.close()
    raise SimulationError(f"no success in {_MOST_EPISODES} episodes with exact depth; there is nothing to measure contact on")


def _contact_physics(touch: _Touch, calls: int) -> list[float]:
    """Press the tip into the tissue, and time the physics steps in contact."""
    loop = touch.env.loop
    theatre, arm = loop.theatre, loop.theatre.tool_arm
    for _ in range(_PRESS_TICKS):
        q, qdot = touch.rcm.step([0.0, 0.0, -_PRESS_MPS], loop.config.control_s)
        theatre.set_joint_targets(arm, q, qdot)
        for _ in range(loop.config.physics_steps_per_control):
            theatre.step()
    theatre.set_joint_targets(arm, touch.rcm.q)
    seconds: list[float] = []
    for _ in range(10 * calls):
        _timed(seconds, theatre.step)
        if np.linalg.norm(theatre.contact_force_in_world()) < _TOUCH_N:
            seconds.pop()
        if len(seconds) == calls:
            return seconds
    raise SimulationError(f"the tip lost the tissue: {len(seconds)} of {10 * calls} physics steps were in contact")


def _reference_stages(theatre: Theatre, rig: Rig, rng: np.random.Generator) -> list[Stage]:
    """Time the reference camera at 2x2 sampling, and the reprojection of all its points at full sampling."""
    world_from_scope = theatre.world_from_camera()
    # Aimed at the point 90 mm in front of the scope.
    world_from_reference = lateral_mount(world_from_scope[:3, 3] + 0.09 * world_from_scope[:3, 2])
    coarse = ReferenceCamera(ReferenceOptics(sampling="2x2"))
    coarse.attach(theatre.model, tissue=theatre.tissue)
    captured = _time(lambda: coarse.capture(theatre.data, world_from_reference, rng), _REFERENCE_CALLS, warm_up=1)
    full = ReferenceCamera(ReferenceOptics(sampling="full"))
    full.attach(theatre.model, tissue=theatre.tissue)
    cloud = full.capture(theatre.data, world_from_reference, rng).xyz
    scope_from_reference = invert_transform(world_from_scope) @ world_from_reference
    projected = _time(lambda: reproject(cloud, scope_from_reference, rig.camera), _REFERENCE_CALLS, warm_up=1)
    return [Stage.of("reference capture, 2x2", captured), Stage.of("reprojection, full cloud", projected)]


def _recorder_times(env: ReachEnv, capture: StripeCapture, calls: int) -> list[float]:
    """Time the Rerun recorder's work of a camera period: a frame, a depth frame, and the control ticks in between."""
    from laploop.envs.recording.rerun_recorder import RerunRecorder  # slow to import

    rates, theatre = env.loop.config, env.loop.theatre
    pose, target = theatre.world_from_camera(), env.target_in_world()
    oracle = OracleEstimator(env.loop.rig)
    oracle.see_truth(capture.depth_mm)
    estimate = oracle.estimate(capture.image)
    seconds: list[float] = []
    with TemporaryDirectory() as folder, RerunRecorder(Path(folder) / "bench.rrd") as recorder:
        recorder.begin(theatre, env.loop.rig)
        for index in range(calls):
            now_ns = index * rates.camera_ns
            times: dict[str, Any] = {"index": index, "captured_ns": now_ns, "available_ns": now_ns, "world_from_camera": pose}
            frame = FrameRecord(
                now_ns=now_ns,
                frame=StripeFrame(image=capture.image, **times),
                exact_depth_mm=capture.depth_mm,
                object_id=capture.object_id,
            )
            depth = DepthRecord(
                now_ns=now_ns,
                depth=DepthFrame(estimate=estimate, **times),
                stripes=capture.image,
                exact_depth_mm=capture.depth_mm,
                tissue=capture.object_id == ObjectId.TISSUE,
            )
            ticks = [
                TickRecord(
                    now_ns=now_ns + number * rates.control_ns,
                    target_error_mm=1.0,
                    target_in_world=target,
                    rcm_error_mm=dict.fromkeys(ARM_NAMES, 0.0),
                    contact_force_n=0.0,
                    depth_age_ms=40.0,
                    stage_ms={"physics": 1.0, "control": 1.0},
                )
                for number in range(rates.camera_ns // rates.control_ns)
            ]
            begin = time.perf_counter()
            recorder.frame(frame)
            recorder.depth(depth)
            for tick in ticks:
                recorder.tick(tick)
            seconds.append(time.perf_counter() - begin)
    return seconds


def _time(call: Callable[[], object], calls: int, warm_up: int = _WARM_UP_CALLS) -> list[float]:
    for _ in range(warm_up):
        call()
    seconds: list[float] = []
    for _ in range(calls):
        _timed(seconds, call)
    return seconds


def _timed(seconds: list[float], call: Callable[..., Any], *arguments: Any) -> Any:
    begin = time.perf_counter()
    result = call(*arguments)
    seconds.append(time.perf_counter() - begin)
    return result
