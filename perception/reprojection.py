"""Reference depth in the scope's image: the points of another depth camera, projected and z-buffered.

The four steps of Rodgers et al. (section 2.5, equations 3 to 6): back-projection of the reference camera's depth, the rigid
transform between the two cameras, projection with the scope's intrinsics, and the nearest depth at each pixel.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, rigid_transform

Array = NDArray[np.float64]

_CHUNK = 1 << 13
"""Number of points processed at a time, so that intermediate results stay in a core's cache."""


_Coefficient = Annotated[float, Field(ge=-1e3, le=1e3)]


@configuration
class BrownDistortion:
    """Lens distortion after Brown (1966), with OpenCV's names and signs.

    With x = X/Z, y = Y/Z and r² = x² + y²:

        x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
        y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y
    """

    k1: _Coefficient = 0.0
    """Radial, of r²."""
    k2: _Coefficient = 0.0
    """Radial, of r⁴."""
    p1: _Coefficient = 0.0
    """Tangential, mainly along y."""
    p2: _Coefficient = 0.0
    """Tangential, mainly along x."""
    k3: _Coefficient = 0.0
    """Radial, of r⁶."""

    @property
    def largest_radius_tan(self) -> float:
        """Tangent of the angle to the axis up to which the radial part grows; beyond, the polynomial folds back."""
        roots = np.roots([7.0 * self.k3, 5.0 * self.k2, 3.0 * self.k1, 1.0])
        turning = [float(root.real) for root in roots if abs(root.imag) < 1e-9 * max(1.0, abs(root)) and root.real > 0.0]
        return math.sqrt(min(turning)) if turning else math.inf

    def apply(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the distorted tangent coordinates of (x, y), two arrays of one shape."""
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        cross = 2.0 * x * y
        return (
            x * radial + self.p1 * cross + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + self.p2 * cross,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ReprojectedDepth:
    """A reference depth map in the scope's image."""

    depth_mm: NDArray[np.float32]
    """(height, width), z-depth in the scope's frame; NaN where no point fell."""
    mask: NDArray[np.bool_]
    """(height, width), the paper's M: True where a point fell."""


def reproject(
    xyz_mm: NDArray[np.floating],
    scope_from_reference: Array,
    intrinsics: Intrinsics,
    distortion: BrownDistortion | None = None,
) -> ReprojectedDepth:
    """Reproject the points of a reference camera into the scope's image (equations 4 to 6).

    A point belongs to the pixel that contains its image; the nearest of several is kept. Points that are NaN, behind the
    scope's camera or outside its image are left out.

    Args:
        xyz_mm: (..., 3) points in the reference camera's frame, millimetres, NaN where invalid; (height, width, 3) as the
            reference camera returns them, or a list (n, 3).
        scope_from_reference: 4x4 rigid transform, metres.
        intrinsics: Of the scope's camera.
        distortion: Of its lens; none by default.

    Raises:
        InvalidValueError: If the points or the transform have another shape, or the transform is not rigid.
    """
    if xyz_mm.ndim < 2 or xyz_mm.shape[-1] != 3:
        raise InvalidValueError("shape of xyz_mm", xyz_mm.shape, "(n, 3) or (height, width, 3)")
    transform = rigid_transform("scope_from_reference", scope_from_reference)
    rotation, offset_mm = transform[:3, :3], 1e3 * transform[:3, 3:]
    points = xyz_mm.reshape(-1, 3)
    count = intrinsics.height * intrinsics.width
    nearest = np.full(count, np.inf, dtype=np.float32)
    for start in range(0, len(points), _CHUNK):
        in_scope = np.asarray(points[start : start + _CHUNK].T, dtype=np.float64)
        # Infinite coordinates become NaN here, for which every comparison is false.
        with np.errstate(invalid="ignore", over="ignore"):
            in_scope = rotation @ in_scope + offset_mm
            pixel, depth = _pixels(in_scope, intrinsics, distortion)
        np.minimum.at(nearest, pixel, depth.astype(np.float32))
    mask = np.isfinite(nearest)
    nearest[~mask] = np.nan
    shape = (intrinsics.height, intrinsics.width)
    return ReprojectedDepth(depth_mm=nearest.reshape(shape), mask=mask.reshape(shape))


def _pixels(points: Array, intrinsics: Intrinsics, distortion: BrownDistortion | None) -> tuple[NDArray[np.intp], Array]:
    """Return pixel number and depth of those points (3, n), in the camera's frame, that lie inside its image."""
    k = intrinsics
    if distortion is None:
        x, y, z = points
        # Multiplied by z > 0 rather than divided, since most points lie outside the image.
        u, v = k.fx * x + k.cx * z, k.fy * y + k.cy * z
        seen = (z > 0.0) & (u >= 0.0) & (v >= 0.0) & (u < k.width * z) & (v < k.height * z)
        depth = z[seen]
        u, v = u[seen] / depth, v[seen] / depth
    else:
        points = points[:, points[2] > 0.0]
        depth = points[2]
        x, y = points[0] / depth, points[1] / depth
        on_lens_x, on_lens_y = distortion.apply(x, y)
        u, v = k.fx * on_lens_x + k.cx, k.fy * on_lens_y + k.cy
        seen = (u >= 0.0) & (v >= 0.0) & (u < k.width) & (v < k.height)
        seen &= x * x + y * y < distortion.largest_radius_tan**2
        u, v, depth = u[seen], v[seen], depth[seen]
    # A quotient just below the border may be rounded up to it.
    column = np.minimum(u.astype(np.intp), k.width - 1)
    row = np.minimum(v.astype(np.intp), k.height - 1)
    return row * k.width + column, depth
