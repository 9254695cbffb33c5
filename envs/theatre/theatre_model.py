"""The theatre as a MuJoCo model: two arms with their shafts, table, wall, stage and phantom."""

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.assets.instrument import CONTACT_JOINTS, build_instrument
from laploop.assets.laparoscope import build_laparoscope
from laploop.assets.operating_table import build_operating_table, build_stage
from laploop.assets.phantom import PHANTOM, TISSUE, build_phantom, copy_mechanics
from laploop.assets.tissue_mesh import TissueMesh
from laploop.assets.ur5 import build_ur5
from laploop.assets.ur5_description import FLANGE
from laploop.envs.theatre.config import TheatreConfig

CAMERA_ARM = "camera_arm"
TOOL_ARM = "tool_arm"
SCOPE_PREFIX = "scope/"
INSTRUMENT_PREFIX = "instrument/"
"""Prefixes, after the arm's own, of all names of the held tool."""
STAGE_PLATE = "stage/plate"
PHANTOM_BODY = f"phantom/{PHANTOM}"
STAGE_BODIES = (STAGE_PLATE, PHANTOM_BODY)
"""Bodies that move with the stage, by prescription."""
TISSUE_FLEX = f"phantom/{TISSUE}"
STAGE_JOINTS = tuple(f"{TOOL_ARM}/{INSTRUMENT_PREFIX}{joint}" for joint in CONTACT_JOINTS)
"""Joints that show the stage's velocity to contacts; see `build_instrument`."""


_OF_PHANTOM = (
    "body_inertia",
    "body_invweight0",
    "body_mass",
    "body_pos",
    "body_subtreemass",
    "bvh_nodeid",
    "dof_M0",
    "dof_invweight0",
    "flex_node0",
    "flex_size",
    "flex_stiffness",
    "flex_vert",
    "flex_vert0",
)
"""The model's arrays that differ between the theatres of two seeds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TheatrePlan:
    """What a theatre's model is made from."""

    config: TheatreConfig
    timestep_s: float
    bases: dict[str, Array]
    """4x4, pose of each arm's base in the world."""
    trocars: dict[str, Array]
    """(3,), metres, centre of each trocar in the world."""
    stage: Array
    """(3,), metres, middle of the stage plate's upper face."""
    mesh: TissueMesh


def compile_theatre(plan: TheatrePlan) -> Any:
    """Compose and compile a theatre, whose phantom has the mechanics of the tetrahedra that contacts need alone."""
    config = plan.config
    spec = build_operating_table(wall_height_m=config.layout.wall_z_m, trocars=plan.trocars)
    spec.modelname = "theatre"
    spec.compiler.fusestatic = False
    spec.option.timestep = plan.timestep_s
    # Tissue elasticity needs the discrete integrator. In contact, Newton takes one or two iterations where conjugate
    # gradients take ten, or, in a hard contact with friction, a hundred.
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    spec.option.tolerance = 1e-9
    # Also limits the linear solve for the free motion, which takes up to 60 when the tissue starts to move.
    spec.option.iterations = 300
    spec.memory = 400 * 2**20
    # MuJoCo scales its own drawings by these; given, they do not depend on the tissue.
    spec.stat.meansize, spec.stat.meanmass = 0.14, 0.3
    for name, prefix, held in (
        (CAMERA_ARM, SCOPE_PREFIX, build_laparoscope(optics=config.scope)),
        (TOOL_ARM, INSTRUMENT_PREFIX, build_instrument(slides=True)),
    ):
        arm = build_ur5()
        arm.attach(held, prefix=prefix, frame=arm.body(FLANGE).add_frame())
        position, quaternion = plan.bases[name][:3, 3], _quaternion(plan.bases[name])
        spec.attach(arm, prefix=f"{name}/", frame=spec.worldbody.add_frame(pos=position, quat=quaternion))
    spec.attach(build_stage(), prefix="stage/", frame=spec.worldbody.add_frame(pos=plan.stage))
    phantom = build_phantom(plan.mesh, config.tissue, whole=False)
    spec.attach(phantom, prefix="phantom/", frame=spec.worldbody.add_frame(pos=plan.stage))
    model = spec.compile()
    _set_mean_inertia(model)
    return model


def with_phantom(model: Any, plan: TheatrePlan) -> Any:
    """Return a copy of a compiled theatre with the plan's phantom and stage in place of its own, without compiling it anew.

    Both theatres must differ in nothing else, and their meshes have the same tetrahedra. Where contacts need all of these, the
    result is, to the bit, what `compile_theatre` makes of the plan. Mass and stiffness are always those of the whole solid.
    """
    result = copy.copy(model)
    phantom = _phantom_alone(plan, whole=False)
    for name in ("flex_node0", "flex_size", "flex_vert", "flex_vert0"):
        getattr(result, name)[:] = getattr(phantom, name)
    tree = int(result.flex_bvhadr[0]), int(phantom.flex_bvhadr[0])
    count = int(phantom.flex_bvhnum[0])
    result.bvh_nodeid[tree[0] : tree[0] + count] = phantom.bvh_nodeid[tree[1] : tree[1] + count]
    first = int(result.body(PHANTOM_BODY).id)
    result.body_pos[first : first + phantom.nbody - 1] = phantom.body_pos[1:]
    partial = len(plan.mesh.outer) < len(plan.mesh.tetrahedra)
    copy_mechanics(_phantom_alone(plan, whole=True) if partial else phantom, result, first_body=first)
    for name in STAGE_BODIES:
        result.body_pos[result.body(name).id] = plan.stage
    mujoco.mj_setConst(result, mujoco.MjData(result))
    _set_mean_inertia(result)
    return result


def _phantom_alone(plan: TheatrePlan, *, whole: bool) -> Any:
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    # Where it will stand: elsewhere, stiffness would differ in its last digit.
    phantom = build_phantom(plan.mesh, plan.config.tissue, whole=whole)
    spec.attach(phantom, frame=spec.worldbody.add_frame(pos=plan.stage))
    model = spec.compile()
    # MuJoCo keeps half a megabyte of every phantom that it compiles, which never comes back.
    mujoco.mj_clearCache(mujoco.mj_getCache())
    return model


def arrays_of_phantom(model: Any) -> dict[str, Array]:
    """Return a copy of everything in a compiled theatre that another phantom of the same tetrahedra would change."""
    return {name: np.array(getattr(model, name)) for name in _OF_PHANTOM} | {"meaninertia": np.array(model.stat.meaninertia)}


def with_arrays(model: Any, arrays: dict[str, Array]) -> Any:
    """Return a copy of a compiled theatre with what `arrays_of_phantom` took from one of the same tetrahedra."""
    result = copy.copy(model)
    for name in _OF_PHANTOM:
        getattr(result, name)[:] = arrays[name]
    result.stat.meaninertia = float(arrays["meaninertia"])
    return result


def _set_mean_inertia(model: Any) -> None:
    """Leave the immovable joints out of the mean inertia, in units of which the solver's tolerance is given."""
    movable = np.ones(model.nv, dtype=np.bool_)
    movable[[model.joint(name).dofadr[0] for name in STAGE_JOINTS]] = False
    model.stat.meaninertia = model.dof_M0[movable].mean()


def _quaternion(transform: Array) -> Array:
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, transform[:3, :3].ravel())
    return quaternion
