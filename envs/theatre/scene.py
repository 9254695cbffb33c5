"""The theatre as one MuJoCo model: two arms with their shafts, table, wall, stage and phantom."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.assets.instrument import build_instrument
from laploop.assets.laparoscope import SHAFT_TIP, build_laparoscope
from laploop.assets.operating_table import STAGE_PLATE_THICKNESS_M, build_operating_table, build_stage
from laploop.assets.phantom import TISSUE, build_phantom
from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.assets.shafts import INSTRUMENT, LAPAROSCOPE, Shaft
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.tissue_mesh import TissueMesh, mean_top_height, solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.assets.ur5 import build_ur5
from laploop.assets.ur5_description import FLANGE, JOINT_NAMES
from laploop.control.arm.model import ArmModel
from laploop.control.arm.start_posture import start_posture
from laploop.envs.theatre.arm import Arm
from laploop.envs.theatre.config import TheatreConfig, TheatreLayout
from laploop.errors import InvalidValueError

CAMERA_ARM = "camera_arm"
TOOL_ARM = "tool_arm"
SCOPE_PREFIX = "scope/"
INSTRUMENT_PREFIX = "instrument/"
"""Prefixes, after the arm's own, of all names of the held tool."""
STAGE_PLATE = "stage/plate"
TISSUE_FLEX = f"phantom/{TISSUE}"

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


def build_scene(
    config: TheatreConfig, rng: np.random.Generator, *, timestep_s: float, solid: TissueMesh | None = None
) -> Scene:
    """Compose and compile the theatre of a configuration; `solid` is a phantom in place of the configuration's."""
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
    model = _compile(
        config,
        mesh,
        timestep_s=timestep_s,
        bases=bases,
        trocars={"scope_trocar": scope_trocar, "tool_trocar": tool_trocar},
        stage=stage,
    )
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

    return Scene(
        model=model,
        camera_arm=arm(CAMERA_ARM, SCOPE_PREFIX, LAPAROSCOPE, scope_trocar, scope_pose, _CAMERA_SEED_Q),
        tool_arm=arm(TOOL_ARM, INSTRUMENT_PREFIX, INSTRUMENT, tool_trocar, _tool_pose(tip, tool_trocar), _TOOL_SEED_Q),
        tissue_mesh=mesh,
        stage_in_world=stage,
        working_distance_m=distance,
    )


def _tissue(config: TissueConfig, rng: np.random.Generator, solid: TissueMesh | None) -> tuple[TissueMesh, float, float]:
    """Return the solid, the mean height of its top and its greatest height, both in metres above the stage."""
    if solid is None and config.mesh is not None:
        solid = load_phantom(config.mesh)
    if solid is not None:
        return solid, mean_top_height(solid), float(solid.points[:, 2].max())
    height = height_field(config.shape, rng)
    return solid_mesh(config.shape, height), float(height.mean()), float(height.max())


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


def _compile(
    config: TheatreConfig,
    mesh: TissueMesh,
    *,
    timestep_s: float,
    bases: dict[str, Array],
    trocars: dict[str, Array],
    stage: Array,
) -> Any:
    spec = build_operating_table(wall_height_m=config.layout.wall_z_m, trocars=trocars)
    spec.modelname = "theatre"
    spec.compiler.fusestatic = False
    spec.option.timestep = timestep_s
    # Tissue elasticity needs the discrete integrator. In contact, Newton takes one or two iterations where conjugate
    # gradients take ten, or, in a hard contact with friction, a hundred.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.tolerance = 1e-6
    # Also limits the linear solve for the free motion, which takes up to 60 when the tissue starts to move.
    spec.option.iterations = 300
    spec.memory = 400 * 2**20
    for name, prefix, held in (
        (CAMERA_ARM, SCOPE_PREFIX, build_laparoscope(optics=config.scope)),
        (TOOL_ARM, INSTRUMENT_PREFIX, build_instrument()),
    ):
        arm = build_ur5()
        arm.attach(held, prefix=prefix, frame=arm.body(FLANGE).add_frame())
        position, quaternion = bases[name][:3, 3], _quaternion(bases[name])
        spec.attach(arm, prefix=f"{name}/", frame=spec.worldbody.add_frame(pos=position, quat=quaternion))
    spec.attach(build_stage(), prefix="stage/", frame=spec.worldbody.add_frame(pos=stage))
    spec.attach(build_phantom(mesh, config.tissue), prefix="phantom/", frame=spec.body(STAGE_PLATE).add_frame())
    return spec.compile()


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


def _quaternion(transform: Array) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, transform[:3, :3].ravel())
    return quaternion
