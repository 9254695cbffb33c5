"""The phantom's surface in the running simulation."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.tissue_mesh import TissueMesh


class Tissue:
    """Visible surface of the deforming phantom: its top and its sides."""

    def __init__(self, model: Any, data: Any, *, flex_name: str, mesh: TissueMesh) -> None:
        """Follow the flex of this name, which was made from `mesh`."""
        self._data = data
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, flex_name)
        self._rows = int(model.flex_vertadr[flex]) + mesh.surface_vertices.astype(np.intp)
        self._triangles = mesh.triangles
        self._top_triangle_count = mesh.top_triangle_count
        self._top_vertex_count = int(self._triangles[: mesh.top_triangle_count].max()) + 1

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(m, 3), indices into `surface_points`, anticlockwise from outside, those of the top first; read-only."""
        return self._triangles

    @property
    def top_triangles(self) -> NDArray[np.int32]:
        """(k, 3), the triangles of the top; read-only."""
        return self._triangles[: self._top_triangle_count]

    @property
    def top_vertex_count(self) -> int:
        """Number of vertices of the top, the first of `surface_points`; the rest belong to the sides alone."""
        return self._top_vertex_count

    def surface_points(self) -> Array:
        """Return the surface's vertices in the world, (n, 3), metres, as of the last refresh of the kinematics."""
        return np.asarray(self._data.flexvert_xpos[self._rows])
