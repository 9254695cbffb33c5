"""The deformable phantom: a fine solid mesh carried by a coarse lattice of interpolated flex cells."""

from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.assets.instrument import TISSUE_COLLISION_BIT, VISIBLE_GROUP
from laploop.assets.tissue_shape import TissueMesh, TissueShape
from laploop.errors import InvalidValueError

TISSUE = "tissue"
"""Name of the flex."""

_SKIN_M = 1e-5
"""Distance between the surface that is seen and the one that is felt."""

_CONTACT_IMPEDANCE = "0.99 0.999 0.0005 0.5 2"
"""Hard enough for the tissue to give way and not the contact: a probe sinks in by less than 0.15 mm at 3 N, where MuJoCo's
default lets its whole ball end through the surface."""

_IDLE = 0.02
"""Nodes with less than this share of the tissue of an inner node are so light and soft that they hardly come to rest."""


@dataclass(frozen=True, kw_only=True)
class TissueMaterial:
    """Mechanics of the phantom.

    The default stiffness lies in the small-strain range of soft tissue, 2-30 kPa. A coarse lattice cannot dent as locally as
    the continuum, so that a probe feels about 0.3 N/mm at 10 kPa with 10x10 cells.
    """

    young_pa: float = 10_000.0
    poisson: float = 0.45
    """0.45-0.48 keeps a nearly incompressible solid numerically sound."""
    density: float = 1060.0
    """kg/m^3, liver (Phys Med Biol 2019;64:225001)."""
    damping_s: float = 0.02
    """Rayleigh damping in proportion to the stiffness: a vibration dies out within a few periods."""
    friction: float = 0.05
    """Sliding friction at the upper end of 0.007-0.054, measured for small bowel against steel (Tribol Lett, 2013)."""
    contact_time_s: float = 0.004
    """Time constant of a contact; at least twice the physics step."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if not 100.0 <= self.young_pa <= 1e6:
            raise InvalidValueError("young_pa", self.young_pa, "100 to 1e6 Pa")
        if not 0.0 <= self.poisson <= 0.49:
            raise InvalidValueError("poisson", self.poisson, "0 to 0.49")
        if not 100.0 <= self.density <= 5000.0:
            raise InvalidValueError("density", self.density, "100 to 5000 kg/m^3")
        if not 0.0 <= self.damping_s <= 1.0:
            raise InvalidValueError("damping_s", self.damping_s, "0 to 1 s")
        if not 0.0 <= self.friction <= 2.0:
            raise InvalidValueError("friction", self.friction, "0 to 2")
        if not 0.001 <= self.contact_time_s <= 0.1:
            raise InvalidValueError("contact_time_s", self.contact_time_s, "0.001 to 0.1 s")


@dataclass(frozen=True, kw_only=True)
class TissueConfig:
    """Shape, mechanics and resolution of the phantom."""

    shape: TissueShape = field(default_factory=TissueShape)
    material: TissueMaterial = field(default_factory=TissueMaterial)
    cells: tuple[int, int] = (10, 10)
    """Lattice cells along x and y; cost grows with their number, and so does the detail of a dent.

    There is one cell from bottom to top: upper cells above a crease would hold next to no tissue, and their nodes, almost
    without mass and stiffness, would fly about.
    """
    solid: TissueMesh | None = None
    """A solid to be the phantom instead of one that `shape` grows; `phantom_mesh.load_phantom` makes one of a file."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a number of cells lies outside its range.
        """
        if len(self.cells) != 2 or not all(2 <= count <= 32 for count in self.cells):
            raise InvalidValueError("cells", self.cells, "two integers from 2 to 32")

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Lattice nodes along x, y and z."""
        return self.cells[0] + 1, self.cells[1] + 1, 2


def build_phantom(mesh: TissueMesh, config: TissueConfig) -> Any:
    """Build the phantom as a `mujoco.MjSpec` with one body, whose origin is below the middle of its flat bottom.

    Nodes of the bottom layer are fixed to that body; everything above is free and elastic. Of a solid of the user's, whose
    outline need not fill its box, those upper nodes are fixed, too, that carry next to no tissue.
    """
    material = config.material
    cells, nodes = config.cells, config.nodes
    points = " ".join(map(repr, mesh.points.ravel().tolist()))
    elements = " ".join(map(str, mesh.tetrahedra.ravel().tolist()))
    volume = _volume(mesh)
    pinned = "" if config.solid is None else _pin(_idle_nodes(mesh, config))
    xml = f"""
<mujoco model="phantom">
  <option integrator="discrete"/>
  <worldbody>
    <body name="phantom">
      <flexcomp name="{TISSUE}" type="direct" dim="3" dof="trilinear" cellcount="{cells[0]} {cells[1]} 1"
                radius="{_SKIN_M!r}" mass="{volume * material.density!r}" rgba="0.86 0.52 0.46 1" group="{VISIBLE_GROUP}"
                point="{points}" element="{elements}">
        <elasticity young="{material.young_pa!r}" poisson="{material.poisson!r}" damping="{material.damping_s!r}"/>
        <contact contype="{TISSUE_COLLISION_BIT}" conaffinity="{TISSUE_COLLISION_BIT}" condim="3" selfcollide="none"
                 priority="1" solref="{material.contact_time_s!r} 1" solimp="{_CONTACT_IMPEDANCE}"
                 friction="{material.friction!r} 0 0"/>
        <pin gridrange="0 0 0 {nodes[0] - 1} {nodes[1] - 1} 0"/>{pinned}
      </flexcomp>
    </body>
  </worldbody>
</mujoco>"""
    return mujoco.MjSpec.from_string(xml)


def _volume(mesh: TissueMesh) -> float:
    corners = mesh.points[mesh.tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.det(edges).sum() / 6.0)


def _pin(nodes: NDArray[np.intp]) -> str:
    return f'<pin grid="{" ".join(map(str, nodes.ravel().tolist()))}"/>' if nodes.size else ""


def _idle_nodes(mesh: TissueMesh, config: TissueConfig) -> NDArray[np.intp]:
    """Return the nodes (k, 3) of the upper layer that carry less than `_IDLE` of the tissue of a node in full cells."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    cells = np.array([*config.cells, 1])
    corners = mesh.points[mesh.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    place = (corners.mean(axis=1) - low) / (high - low) * cells
    cell = np.minimum(place.astype(np.intp), cells - 1)
    x, y, z = (place - cell).T
    carried = np.zeros(config.nodes[:2])
    for i, along_x in enumerate((1.0 - x, x)):
        for j, along_y in enumerate((1.0 - y, y)):
            np.add.at(carried, (cell[:, 0] + i, cell[:, 1] + j), volumes * along_x * along_y * z)
    full = 0.5 * float(np.prod((high - low) / cells))
    idle = np.argwhere(carried < _IDLE * full)
    return np.column_stack([idle, np.ones(len(idle), dtype=np.intp)])
