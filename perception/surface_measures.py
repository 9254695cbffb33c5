"""Depth as a surface: its normals, and where it steps from one surface to another.

The normal of a pinhole camera's depth map follows from the differences of depth alone: with the point P = z (x, y, 1) and
x = (u - cx) / fx, y = (v - cy) / fy,

    dP/du x dP/dv  is parallel to  (-fx z_u, -fy z_v, z + (u - cx) z_u + (v - cy) z_v) = n,

z_u and z_v being central differences. Its product with the ray (x, y, 1) is z, so that an error of depth e lies e z / |n| off
the surface.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics

Array = NDArray[np.float64]
Bool = NDArray[np.bool_]

STEP_MM = 3.0
"""Neighbouring pixels whose depths differ by more lie on different surfaces."""
EDGE_PX = 3
"""Pixels up to this far from such a step count as its edge."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceErrors:
    """How an estimate's surface differs from the true one; all arrays are (height, width)."""

    plane_mm: Array
    """Distance of the estimated point from the plane that touches the true surface in the same pixel."""
    normal_deg: Array
    """Angle between the two normals."""
    smooth: Bool
    """Where both mean something."""
    edge: Bool
    """Pixels at a step of the true depth."""


class TrueSurface:
    """The surface of a true depth map, prepared once for all estimates."""

    def __init__(self, depth_mm: NDArray[np.float32], camera: Intrinsics) -> None:
        """Work out normals and steps.

        Args:
            depth_mm: (height, width), NaN where there is nothing.
            camera: Took the picture.

        Raises:
            InvalidValueError: If the size is not the camera's.
        """
        if depth_mm.shape != (camera.height, camera.width):
            raise InvalidValueError("shape of depth_mm", depth_mm.shape, f"{(camera.height, camera.width)}, the camera's")
        self._camera = camera
        self._depth_mm = depth_mm.astype(np.float64)
        across, along = np.abs(np.diff(self._depth_mm, axis=1)), np.abs(np.diff(self._depth_mm, axis=0))
        stepped = np.zeros(depth_mm.shape, dtype=bool)
        smooth = np.isfinite(self._depth_mm)
        smooth[:, [0, -1]] = smooth[[0, -1]] = False
        for first, second, step in (
            (np.s_[:, :-1], np.s_[:, 1:], across),
            (np.s_[:-1], np.s_[1:], along),
        ):
            # A neighbour that is NaN is no step, but leaves nothing to take a difference from.
            for part in (first, second):
                stepped[part] |= step > STEP_MM
                smooth[part] &= step <= STEP_MM
        disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * EDGE_PX + 1, 2 * EDGE_PX + 1))
        self.smooth: Bool = smooth
        """(height, width), where the true surface has a normal."""
        self.edge: Bool = cv2.dilate(stepped.astype(np.uint8), disk) > 0
        """(height, width), pixels at a step."""
        self._normal, self._length = self._normals(np.nan_to_num(self._depth_mm))

    def compare(self, depth_mm: NDArray[np.float32]) -> SurfaceErrors:
        """Compare an estimate (height, width), finite everywhere."""
        estimate, true = depth_mm.astype(np.float64), np.nan_to_num(self._depth_mm)
        normal, length = self._normals(estimate)
        product: Array = np.asarray(sum(mine * his for mine, his in zip(normal, self._normal, strict=True)))
        return SurfaceErrors(
            plane_mm=np.abs(estimate - true) * true / self._length,
            normal_deg=np.degrees(np.arccos(np.clip(product / (length * self._length), -1.0, 1.0))),
            smooth=self.smooth,
            edge=self.edge,
        )

    def _normals(self, depth_mm: Array) -> tuple[tuple[Array, Array, Array], Array]:
        """Return the normals of a depth map, not of unit length, and their lengths."""
        camera = self._camera
        over_u, over_v = np.zeros_like(depth_mm), np.zeros_like(depth_mm)
        over_u[:, 1:-1] = 0.5 * (depth_mm[:, 2:] - depth_mm[:, :-2])
        over_v[1:-1] = 0.5 * (depth_mm[2:] - depth_mm[:-2])
        u = np.arange(camera.width) + 0.5 - camera.cx
        v = (np.arange(camera.height) + 0.5 - camera.cy)[:, None]
        normal = (-camera.fx * over_u, -camera.fy * over_v, depth_mm + u * over_u + v * over_v)
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        return normal, np.maximum(length, 1e-9)


def with_neighbours(mask: Bool) -> Bool:
    """Return the pixels of a mask (height, width) whose four neighbours, as far as there are any, belong to it too."""
    whole = mask.copy()
    whole[1:] &= mask[:-1]
    whole[:-1] &= mask[1:]
    whole[:, 1:] &= mask[:, :-1]
    whole[:, :-1] &= mask[:, 1:]
    return whole
