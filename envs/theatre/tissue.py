"""The phantom's surface in the running simulation."""

from typing import Any

import mujoco
import numpy as np

from laploop.arrays import Array
from laploop.assets.tissue_mesh import TissueMesh
from laploop.envs.sensors.tracing.tissue_surface import flex_rest_points


class Tissue:
    """Visible surface of the deforming phantom: its top and its sides."""

    def __init__(self, model: Any, data: Any, *, flex_name: str, mesh: TissueMesh) -> None:
        """Follow the flex of this name, which was made from `mesh`."""
        self._data = data
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, flex_name)
        self._rows = int(model.flex_vertadr[flex]) + mesh.surface_vertices.astype(np.intp)
        self.triangles = mesh.triangles
        """(m, 3), indices into `surface_points`, anticlockwise from outside, those of the top first; read-only."""
        self.top_triangles = mesh.triangles[: mesh.top_triangle_count]
        """(k, 3), the triangles of the top; read-only."""
        self.rest_points = flex_rest_points(model)[self._rows]
        """(n, 3), metres, the vertices in the model's reference pose; the tissue's texture sticks to them."""
        self.top_vertex_count = int(self.top_triangles.max()) + 1
        """Number of vertices of the top, the first of `surface_points`; the rest belong to the sides alone."""

    def surface_points(self) -> Array:
        """Return the surface's vertices in the world, (n, 3), metres, as of the last refresh of the kinematics."""
        return np.asarray(self._data.flexvert_xpos[self._rows])
