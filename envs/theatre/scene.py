"""Where everything in a theatre stands, as a seed draws it, and the model of that."""

import hashlib
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.assets.laparoscope import SHAFT_TIP
from laploop.assets.operating_table import STAGE_PLATE_THICKNESS_M
from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.assets.shafts import INSTRUMENT, LAPAROSCOPE, Shaft
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.tissue_mesh import TissueMesh, mean_top_height, solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.assets.ur5_description import JOINT_NAMES
from laploop.control.arm.model import ArmModel
from laploop.control.arm.start_posture import start_posture
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.config import TheatreConfig, TheatreLayout
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.envs.theatre.scene_cache import BoundedCache
from laploop.envs.theatre.settling import settled_positions
from laploop.envs.theatre.theatre_model import (
    CAMERA_ARM,
    INSTRUMENT_PREFIX,
    SCOPE_PREFIX,
    TOOL_ARM,
    TheatrePlan,
    arrays_of_phantom,
    compile_theatre,
    with_arrays,
    with_phantom,
)
from laploop.envs.theatre.trocar import TrocarConfig
from laploop.errors import InvalidValueError

_CAMERA_SEED_Q = np.array([-0.20, -1.31, 0.77, -1.03, -1.57, -1.77])
_TOOL_SEED_Q = np.array([-0.28, -1.79, 1.86, -2.31, -1.39, -0.22])
"""Elbow up, wrist above the wall, far from singularities."""

_WORKING_DISTANCE_RANGE_M = (0.075, 0.105)
_TIP_CLEARANCE_M = 0.022
"""Initial height of the tool's tip above the highest point of the tissue at rest; breathing lessens it by 5 mm."""
_SCOPE_CLEARANCE_M = 0.035
"""Smallest clearance between the scope's tip and the highest point of the tissue at rest; the tool's tip moves there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A compiled model and the places of its parts."""

    model: Any
    camera_arm: Arm
    tool_arm: Arm
    tissue_mesh: TissueMesh
    stage_in_world: Array
    """(3,), middle of the stage plate's upper face when the base motion is zero."""
    working_distance_m: float
    settled_qpos: Array
    """(nq,), arms at home and tissue at rest under its weight."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _KeptScene:
    scene: Scene
    arrays: dict[str, Array]
    """What tells its model from that of another seed."""


_TEMPLATES: BoundedCache[Any] = BoundedCache(4)
"""Compiled theatres, 5 MB each."""
_SCENES: BoundedCache[_KeptScene] = BoundedCache(64)
"""Of seeds, about 1.5 MB each."""


def scene_of(config: TheatreConfig, seed: int, *, timestep_s: float, solid: TissueMesh | None = None) -> Scene:
    """Return the scene of a configuration and a seed, with a model of its own.

    Recent scenes are cached (`laploop.envs.theatre.scene_cache`); a cached scene equals a newly built one to the bit.

    Args:
        config: The theatre; what moves it and what holds the shafts plays no part here.
        seed: Decides the tissue and where things stand.
        timestep_s: The physics step.
        solid: A phantom in place of the configuration's.

    Raises:
        InvalidValueError: If stage or tissue have too little clearance, or the phantom's file cannot be read.
        SimulationError: If the tissue does not come to rest.
    """
    if solid is None and config.tissue.mesh is not None:
        solid = load_phantom(config.tissue.mesh)
    stands = replace(config, motion=BaseMotion(), travel=StageTravel(), trocar=TrocarConfig(), actuation=ActuationConfig())
    # The kept scene holds on to its solid, so that no other object can get the same id.
    kept = _SCENES.get((stands, seed, timestep_s, id(solid)), lambda: _kept_scene(stands, seed, timestep_s, solid))
    return replace(kept.scene, model=with_arrays(kept.scene.model, kept.arrays))


def _kept_scene(config: TheatreConfig, seed: int, timestep_s: float, solid: TissueMesh | None) -> _KeptScene:
    rng = np.random.default_rng(seed).spawn(1)[0]
    layout = config.layout
    mesh, mean_height, top_height = _tissue(config.tissue, rng, solid)
    drawn_distance = float(rng.uniform(*_WORKING_DISTANCE_RANGE_M))
    tip_x, tip_y = rng.uniform(0.036, 0.042), rng.uniform(-0.008, 0.008)
    distance = drawn_distance if config.working_distance_m is None else config.working_distance_m
    stage = np.array([0.0, 0.0, layout.scope_tip_z_m - distance - mean_height])
    _check_clearances(stage, top_height, layout)
    tip = np.array([tip_x, tip_y, stage[2] + top_height + _TIP_CLEARANCE_M])
    scope_trocar = np.array([0.0, 0.0, layout.wall_z_m])
    tool_trocar = np.array([layout.tool_trocar_x_m, 0.0, layout.wall_z_m])
    bases = {
        CAMERA_ARM: _transform(np.eye(3), np.array([layout.camera_base_x_m, 0.0, 0.0])),
        TOOL_ARM: _transform(np.diag([-1.0, -1.0, 1.0]), np.array([layout.tool_base_x_m, 0.0, 0.0])),
    }
    plan = TheatrePlan(
        config=config,
        timestep_s=timestep_s,
        bases=bases,
        trocars={"scope_trocar": scope_trocar, "tool_trocar": tool_trocar},
        stage=stage,
        mesh=mesh,
    )
    template = _TEMPLATES.get(_template_key(plan), lambda: compile_theatre(plan))
    model = with_phantom(template, plan)
    scope_pose = _transform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, layout.scope_tip_z_m]))

    def arm(name: str, prefix: str, shaft: Shaft, trocar: Array, shaft_pose: Array, seed_q: Array) -> Arm:
        joints = [model.joint(f"{name}/{joint}") for joint in JOINT_NAMES]
        home_q = start_posture(ArmModel(bases[name], shaft), shaft_pose, seed_q)
        for array in (bases[name], trocar, home_q):
            array.flags.writeable = False
        return Arm(
            name=name,
            shaft=shaft,
            world_from_base=bases[name],
            trocar_in_world=trocar,
            home_q=home_q,
            qpos_indices=np.array([joint.qposadr[0] for joint in joints], dtype=np.int32),
            dof_indices=np.array([joint.dofadr[0] for joint in joints], dtype=np.int32),
            actuator_indices=np.array([model.actuator(f"{name}/{joint}").id for joint in JOINT_NAMES], dtype=np.int32),
            tip_site=int(model.site(f"{name}/{prefix}{SHAFT_TIP}").id),
        )

    arms = (
        arm(CAMERA_ARM, SCOPE_PREFIX, LAPAROSCOPE, scope_trocar, scope_pose, _CAMERA_SEED_Q),
        arm(TOOL_ARM, INSTRUMENT_PREFIX, INSTRUMENT, tool_trocar, _tool_pose(tip, tool_trocar), _TOOL_SEED_Q),
    )
    scene = Scene(
        # Without what `arrays` holds, it serves all scenes of the same tetrahedra.
        model=template,
        camera_arm=arms[0],
        tool_arm=arms[1],
        tissue_mesh=mesh,
        stage_in_world=stage,
        working_distance_m=distance,
        settled_qpos=settled_positions(model, arms),
    )
    for array in (scene.stage_in_world, scene.settled_qpos):
        array.flags.writeable = False
    return _KeptScene(scene=scene, arrays=arrays_of_phantom(model))


def _template_key(plan: TheatrePlan) -> tuple[Hashable, ...]:
    """Return what decides all of a model but the arrays that `with_phantom` replaces."""
    mesh = plan.mesh
    shape = hashlib.sha256(mesh.tetrahedra[mesh.outer].tobytes())
    if not mesh.fills_box:
        # Which nodes are fixed depends on the solid itself.
        shape.update(mesh.points.tobytes())
    config = plan.config
    return config.layout, config.scope, config.tissue.material, config.tissue.cells, plan.timestep_s, shape.digest()


def _tissue(config: TissueConfig, rng: np.random.Generator, solid: TissueMesh | None) -> tuple[TissueMesh, float, float]:
    """Return the solid, the mean height of its top and its greatest height, both in metres above the stage."""
    if solid is not None:
        return solid, mean_top_height(solid), float(solid.points[:, 2].max())
    height = height_field(config.shape, rng)
    return solid_mesh(config.shape, height, config.cells, config.contact_every), float(height.mean()), float(height.max())


def _check_clearances(stage: Array, top_height: float, layout: TheatreLayout) -> None:
    """Raise unless the stage clears the table, and the tissue the scope."""
    if stage[2] < STAGE_PLATE_THICKNESS_M:
        allowed = f"at least {STAGE_PLATE_THICKNESS_M} m; a flatter phantom or a smaller working distance raises it"
        raise InvalidValueError("height of the stage above the table", round(float(stage[2]), 4), allowed)
    clearance = layout.scope_tip_z_m - float(stage[2]) - top_height
    if clearance < _SCOPE_CLEARANCE_M:
        allowed = f"at least {_SCOPE_CLEARANCE_M} m; a flatter phantom or a larger working distance gives more"
        name = "clearance between the scope's tip and the highest point of the tissue"
        raise InvalidValueError(name, round(clearance, 4), allowed)


def _tool_pose(tip: Array, trocar: Array) -> Array:
    """Return the shaft's pose with its tip in place, through its trocar, its x close to the world's y."""
    z = (tip - trocar) / np.linalg.norm(tip - trocar)
    y = np.cross(z, [0.0, 1.0, 0.0])
    y /= np.linalg.norm(y)
    return _transform(np.column_stack([np.cross(y, z), y, z]), tip)


def _transform(rotation: Array, position: Array) -> Array:
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = position
    return transform
