"""The phantom's surface in the running simulation."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from laploop.arrays import Array
from laploop.assets.tissue_mesh import TissueMesh


class Tissue:
    """Visible surface of the deforming phantom: its top and its sides.

    MuJoCo carries a lattice of nodes and the mesh that contacts need. The visible surface hangs on the same lattice: every
    vertex is the mean of its cell's eight nodes with constant (trilinear) weights.
    """

    def __init__(self, model: Any, data: Any, *, flex_name: str, mesh: TissueMesh) -> None:
        """Follow the flex of this name, which was made from `mesh`."""
        self._data = data
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, flex_name)
        first = int(model.flex_nodeadr[flex])
        nodes = slice(first, first + int(model.flex_nodenum[flex]))
        self._bodies = np.array(model.flex_nodebodyid[nodes])
        # Fixed nodes have no body of their own, but a place in the one that carries the phantom.
        self._places = np.array(model.flex_node[nodes])
        self._carrier = int(self._bodies[np.flatnonzero(self._places.any(axis=1))[0]])
        low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
        self._nodes, self._weights = _lattice_weights((mesh.surface_points - low) / (high - low), model.flex_cellnum[flex])
        starts = np.arange(0, self._nodes.size + 1, 8)
        shape = (len(self._nodes), len(self._bodies))
        self._matrix = sparse.csr_array((self._weights.ravel(), self._nodes.ravel(), starts), shape=shape)
        self.rest_points = mesh.surface_points + model.body_pos[self._carrier]
        """(n, 3), metres, the vertices in the model's reference pose; the tissue's texture sticks to them."""
        self.triangles = mesh.triangles
        """(m, 3), indices into `surface_points`, anticlockwise from outside, those of the top first; read-only."""
        self.top_triangles = mesh.triangles[: mesh.top_triangle_count]
        """(k, 3), the triangles of the top; read-only."""
        self.top_vertex_count = int(self.top_triangles.max()) + 1
        """Number of vertices of the top, the first of `surface_points`; the rest belong to the sides alone."""

    def surface_points(self) -> Array:
        """Return the surface's vertices in the world, (n, 3), metres, as of the last update of the kinematics."""
        return np.asarray(self._matrix @ self._node_points())

    def __getitem__(self, rows: NDArray[np.integer]) -> Array:
        """Return some of `surface_points`, (*rows.shape, 3), at the cost of these alone."""
        nodes = self._node_points()[self._nodes[rows]]
        return np.asarray((self._weights[rows][..., None] * nodes).sum(axis=-2))

    def _node_points(self) -> Array:
        """Return the lattice's nodes in the world, (nodes, 3)."""
        rotation = self._data.xmat[self._carrier].reshape(3, 3)
        return np.asarray(self._data.xpos[self._bodies] + self._places @ rotation.T)


def _lattice_weights(places: Array, cells: NDArray[np.integer]) -> tuple[NDArray[np.int32], Array]:
    """Return node and weight of the eight corners of each point's cell, both (n, 8).

    Args:
        places: (n, 3), points in the lattice's box, 0 to 1 along each axis.
        cells: (3,), cells along each axis; nodes are numbered with z fastest, x slowest.
    """
    scaled = places * cells
    cell = np.minimum(scaled.astype(np.int32), cells - 1)
    upper = scaled - cell
    # Of both ends along each axis; a corner's node is the sum of three, its weight the product.
    strides = np.array([(cells[1] + 1) * (cells[2] + 1), cells[2] + 1, 1])
    x, y, z = (np.stack([cell, cell + 1], axis=1) * strides).astype(np.int32).transpose(2, 0, 1)
    nodes = x[:, :, None, None] + y[:, None, :, None] + z[:, None, None, :]
    u, v, w = np.stack([1.0 - upper, upper], axis=1).transpose(2, 0, 1)
    weights = u[:, :, None, None] * v[:, None, :, None] * w[:, None, None, :]
    return nodes.reshape(-1, 8), weights.reshape(-1, 8)
