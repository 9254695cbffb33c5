"""How a scope that pivots at its trocar has to move so that what it sees moves as wanted."""

import numpy as np

from laploop.arrays import Array


def scope_tip_velocity(point_rate: Array, way: Array, inserted: float) -> Array:
    """Return the velocity (3,) of the tip that moves a resting point at a rate in the camera's frame.

    A scope of which L is inserted pivots at its trocar. Its tip, at (b/2, 0, 0) of the camera's frame, moves by v; then the
    shaft turns by omega = (-v_y, v_x, 0) / L, and a point at rest at (x, y, z) moves in the camera's frame by

        dx = -(1 + z/L) v_x,   dy = -(1 + z/L) v_y,   dz = (x - b/2)/L v_x + y/L v_y - v_z,

    which is solved for v in closed form. The roll about the shaft is left to the arm.

    Args:
        point_rate: (3,), m/s.
        way: (3,), from the tip to the point, in the camera's frame.
        inserted: Length of the shaft inside, metres.
    """
    across = -point_rate[:2] / (1.0 + way[2] / inserted)
    return np.array([*across, float(way[:2] @ across) / inserted - point_rate[2]])
