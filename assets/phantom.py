"""The deformable phantom: a fine solid mesh carried by a coarse lattice of interpolated flex cells."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.instrument import TISSUE_COLLISION_BIT, VISIBLE_GROUP
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.tissue_mesh import TissueMesh

TISSUE = "tissue"
"""Name of the flex."""

PHANTOM = "phantom"
"""Name of the body that carries it."""

_SKIN_M = 1e-5
"""Distance between the visible surface and the one that collides."""

_CONTACT_IMPEDANCE = "0.99 0.999 0.0005 0.5 2"
"""Hard enough that the tissue yields and not the contact: a probe penetrates less than 0.15 mm at 3 N, where with MuJoCo's
default its whole ball end passes through the surface."""

_IDLE = 0.02
"""Nodes that carry less than this fraction of an inner node's tissue are so light and soft that they hardly come to rest."""


def build_phantom(mesh: TissueMesh, config: TissueConfig) -> Any:
    """Build the phantom as a `mujoco.MjSpec` with one body, `PHANTOM`, whose origin is the middle of the flat bottom.

    The body's place is prescribed (a mocap body): attach it to the world. Nodes of the bottom layer are fixed to it; everything
    above is free and elastic. Where a mesh does not fill its box, upper nodes that carry next to no tissue are fixed, too.
    """
    material = config.material
    cells, nodes = config.cells, config.nodes
    points = " ".join(map(repr, mesh.points.ravel().tolist()))
    elements = " ".join(map(str, mesh.tetrahedra.ravel().tolist()))
    corners = mesh.points[mesh.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1])
    volume = float(volumes.sum() / 6.0)
    idle = [] if mesh.fills_box else _idle_nodes(mesh, config, volumes / 6.0).ravel().tolist()
    pinned = f'<pin grid="{" ".join(map(str, idle))}"/>' if idle else ""
    xml = f"""
<mujoco model="phantom">
  <option integrator="discrete"/>
  <worldbody>
    <body name="{PHANTOM}" mocap="true">
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


def _idle_nodes(mesh: TissueMesh, config: TissueConfig, volumes: Array) -> NDArray[np.intp]:
    """Return the nodes (k, 3) of the upper layer that carry less than `_IDLE` of the tissue of a node between full cells."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    cells = np.array([*config.cells, 1])
    place = (mesh.points[mesh.tetrahedra].mean(axis=1) - low) / (high - low) * cells
    cell = np.minimum(place.astype(np.intp), cells - 1)
    x, y, z = (place - cell).T
    carried = np.zeros(config.nodes[:2])
    for i, along_x in enumerate((1.0 - x, x)):
        for j, along_y in enumerate((1.0 - y, y)):
            np.add.at(carried, (cell[:, 0] + i, cell[:, 1] + j), volumes * along_x * along_y * z)
    full = 0.5 * float(np.prod((high - low) / cells))
    idle = np.argwhere(carried < _IDLE * full)
    return np.column_stack([idle, np.ones(len(idle), dtype=np.intp)])
