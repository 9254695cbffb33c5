"""One tissue on its stage and a free instrument: what the endoscope sees of the theatre, without arms."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.assets.instrument import build_instrument
from laploop.assets.operating_table import build_stage
from laploop.assets.phantom import PHANTOM, TISSUE, build_phantom
from laploop.assets.shafts import INSTRUMENT
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.tissue_mesh import solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.envs.theatre.tissue import Tissue

Array = NDArray[np.float64]

_PLATE = "stage/plate"
_HOLDER = "tool_holder"
TIMESTEP_S = 0.002
_AWAY = np.array([2.0, 0.0, 1.0])


class TrainingScene:
    """A tissue on its stage, and an instrument that can be placed anywhere; the tissue gives way.

    World: z up, metres, origin in the middle of the stage's upper face, on which the phantom lies.
    """

    def __init__(self, config: TissueConfig, rng: np.random.Generator, *, furnish: Callable[[Any], None] | None = None) -> None:
        """Grow one tissue from `rng` and compile it with stage and instrument.

        `furnish` adds further objects to the `mujoco.MjSpec` before it is compiled.
        """
        height = height_field(config.shape, rng)
        mesh = solid_mesh(config.shape, height, config.cells)
        self.mean_height_m = float(height.mean())
        spec = build_stage()
        spec.modelname = "training"
        spec.option.timestep = TIMESTEP_S
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        spec.option.solver = mujoco.mjtSolver.mjSOL_CG
        spec.option.tolerance = 1e-6
        spec.memory = 400 * 2**20
        for geom in spec.geoms:
            # The camera tells objects apart by the theatre's prefixes.
            geom.name = f"stage/{geom.name}"
        plate = spec.body("plate")
        plate.name = _PLATE
        spec.attach(build_phantom(mesh, config), prefix="phantom/", frame=spec.worldbody.add_frame())
        holder = spec.worldbody.add_body(name=_HOLDER, mocap=True)
        spec.attach(build_instrument(), prefix="tool_arm/instrument/", frame=holder.add_frame())
        if furnish is not None:
            furnish(spec)
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._stage = [int(self.model.body(name).mocapid[0]) for name in (_PLATE, f"phantom/{PHANTOM}")]
        self._holder = int(self.model.body(_HOLDER).mocapid[0])
        self.tissue = Tissue(self.model, self.data, flex_name=f"phantom/{TISSUE}", mesh=mesh)
        self.reset()

    def reset(self) -> None:
        """Put the tissue to rest and the instrument out of sight."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.mocap_pos[self._holder] = _AWAY
        self._refresh()

    def top_points(self) -> Array:
        """Return the vertices of the tissue's top, (n, 3)."""
        return self.surface_points()[: self.tissue.top_vertex_count]

    def surface_points(self) -> Array:
        """Return all vertices of the tissue's surface, (n, 3)."""
        return self.tissue.surface_points()

    def place_tool(self, tip: Array, axis: Array) -> None:
        """Put the centre of the instrument's ball end at `tip` (3,), its shaft along the unit vector `axis` to the tip."""
        self._hold(tip, axis)
        self._refresh()

    def press_tool(self, tip: Array, axis: Array, *, travel_m: float, speed_m_s: float = 0.08) -> None:
        """Move the instrument along its axis to `tip`, from `travel_m` before it; the tissue gives way.

        Moderately fast: the shape of the tissue matters, not its history.
        """
        steps = max(1, round(travel_m / (speed_m_s * TIMESTEP_S)))
        for step in range(steps + 1):
            self._hold(tip - axis * travel_m * (1.0 - step / steps), axis)
            mujoco.mj_step(self.model, self.data)
        self._refresh()

    def _hold(self, tip: Array, axis: Array) -> None:
        rotation = np.column_stack([*_perpendicular(axis), axis])
        self.data.mocap_pos[self._holder] = tip - INSTRUMENT.length_m * axis
        mujoco.mju_mat2Quat(self.data.mocap_quat[self._holder], rotation.ravel())

    def _refresh(self) -> None:
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_flex(self.model, self.data)


def _perpendicular(axis: Array) -> tuple[Array, Array]:
    """Return x and y that make a right-handed frame with the unit vector `axis` as z."""
    y = np.cross(axis, [0.0, 1.0, 0.0])
    y /= np.linalg.norm(y)
    return np.cross(y, axis), y
