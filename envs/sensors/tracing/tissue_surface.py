"""What a camera sees of tissue: a mesh whose vertices move."""

from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.errors import InvalidValueError


class TissueSurface(Protocol):
    """The visible surface of a tissue, which need not be the mesh that the physics carries."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """(m, 3), indices of vertices, anticlockwise from outside."""

    @property
    def rest_points(self) -> Array:
        """(n, 3), metres, the vertices in the model's reference pose; the tissue's texture sticks to them."""

    def surface_points(self) -> Array:
        """Return where the vertices are in the world, (n, 3), metres, as of the last refresh of the kinematics."""


class FlexSurface:
    """The surface of a flex, as MuJoCo deforms it."""

    def __init__(self, model: mujoco.MjModel, flex: int) -> None:
        """Take the flex of this number.

        Raises:
            InvalidValueError: If it is a line, which has no surface.
        """
        dim = int(model.flex_dim[flex])
        if dim == 3:
            start, count = int(model.flex_shelldataadr[flex]), int(model.flex_shellnum[flex])
            corners = model.flex_shell[start : start + 3 * count]
        elif dim == 2:
            start, count = int(model.flex_elemdataadr[flex]), int(model.flex_elemnum[flex])
            corners = model.flex_elem[start : start + 3 * count]
        else:
            raise InvalidValueError(f"dimension of flex {flex}", dim, "2 or 3; a line has no surface")
        vertices, triangles = np.unique(corners, return_inverse=True)
        self._rows = vertices.astype(np.intp) + int(model.flex_vertadr[flex])
        self.triangles = triangles.reshape(-1, 3).astype(np.int32)
        """(m, 3), indices of vertices."""
        self.rest_points = flex_rest_points(model)[self._rows]
        """(n, 3), metres, the vertices in the model's reference pose."""

    def points(self, data: Any) -> Array:
        """Return where the vertices are in the world, (n, 3), metres."""
        return np.asarray(data.flexvert_xpos[self._rows])


def flex_rest_points(model: Any) -> Array:
    """Return where the vertices of all flexes are in the model's reference pose, (n, 3), metres."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    return np.array(data.flexvert_xpos)
