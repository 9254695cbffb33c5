"""Camera and rig geometry, in numpy alone.

The camera is the computer-vision one: x right, y down, z forward, pixel centres at +0.5 (the centre of the first pixel is
(0.5, 0.5)), depth is z and not the length of the ray. Rigid transforms are 4x4 and named `a_from_b`; points are named
`point_in_a`.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

Array = NDArray[np.float64]

_FARTHEST_M = 100.0
"""Largest translation of a transform: a camera sees nothing that far away."""

_Size = Annotated[int, Field(ge=1, le=16384)]
_Focal = Annotated[float, Field(gt=0.0, le=1e6)]
_Centre = Annotated[float, Field(ge=-1e6, le=1e6)]


@configuration
class Intrinsics:
    """Pinhole intrinsics without distortion, in pixels."""

    width: _Size
    height: _Size
    fx: _Focal
    fy: _Focal
    cx: _Centre
    cy: _Centre

    @classmethod
    def from_fov(cls, *, width: int, height: int, fov_rad: float) -> "Intrinsics":
        """Make a centred camera with square pixels from its full horizontal field of view."""
        focal = 0.5 * width / math.tan(0.5 * fov_rad)
        return cls(width=width, height=height, fx=focal, fy=focal, cx=0.5 * width, cy=0.5 * height)

    @cached_property
    def matrix(self) -> Array:
        """The 3x3 matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def rays(self) -> Array:
        """Rays through all pixel centres, (height, width, 3), scaled to z = 1 in the camera's frame."""
        x = (np.arange(self.width) + 0.5 - self.cx) / self.fx
        y = (np.arange(self.height) + 0.5 - self.cy) / self.fy
        grid_x, grid_y = np.meshgrid(x, y)
        return np.stack([grid_x, grid_y, np.ones_like(grid_x)], axis=-1)

    @cached_property
    def axis_tangents(self) -> Array:
        """Tangents of the angles between the rays and the optical axis, (height, width)."""
        return np.asarray(np.linalg.norm(self.rays[..., :2], axis=-1))

    def project(self, points_in_camera: Array) -> Array:
        """Project points (..., 3) in metres to pixels (..., 2); z must be positive."""
        z = points_in_camera[..., 2]
        u = self.fx * points_in_camera[..., 0] / z + self.cx
        v = self.fy * points_in_camera[..., 1] / z + self.cy
        return np.stack([u, v], axis=-1)

    def unproject(self, pixels: Array, depth_m: Array | float) -> Array:
        """Lift pixels (..., 2) at z-depth (...) in metres to points (..., 3) in the camera's frame."""
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        depth = np.broadcast_to(np.asarray(depth_m, dtype=np.float64), x.shape)
        return np.stack([x * depth, y * depth, depth], axis=-1)


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A camera and a parallel stripe projector `baseline_m` along the camera's +x.

    For a point at depth Z seen at tangent coordinate `x_c`, the projector's tangent coordinate is `x_p = x_c - b / Z`.
    """

    camera: Intrinsics
    baseline_m: float
    mask: StripeMask

    def __post_init__(self) -> None:
        for name, kind in (("camera", Intrinsics), ("mask", StripeMask)):
            if not isinstance(getattr(self, name), kind):
                raise InvalidValueError(name, getattr(self, name), kind.__name__)
        if not isinstance(self.baseline_m, int | float) or not 0.0 < self.baseline_m <= 1.0:
            raise InvalidValueError("baseline_m", self.baseline_m, "above 0, at most 1")

    @classmethod
    def from_optics(cls, optics: ScopeOptics) -> "Rig":
        """Make the nominal rig of a scope."""
        camera = _pinhole(optics.width, optics.height, optics.fov_rad)
        return cls(camera=camera, baseline_m=optics.baseline_m, mask=optics.mask)

    @property
    def projector_from_camera(self) -> Array:
        """Rigid transform, 4x4, metres."""
        transform = np.eye(4)
        transform[0, 3] = -self.baseline_m
        return transform

    def projector_x(self, depth_m: Array) -> Array:
        """Tangent coordinate x_p on the mask that lights each camera pixel, (H, W), for z-depth (H, W) in metres."""
        return self.camera.rays[..., 0] - self.baseline_m / depth_m

    def depth_from_projector_x(self, projector_x: Array) -> Array:
        """Triangulate: z-depth in metres, (H, W), from the mask coordinate seen at each pixel; NaN where rays diverge."""
        difference = self.camera.rays[..., 0] - projector_x
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(difference > 0.0, self.baseline_m / difference, np.nan)


@lru_cache(maxsize=16)
def _pinhole(width: int, height: int, fov_rad: float) -> Intrinsics:
    """Return the camera of a scope; many environments share its table of rays, 1.5 MB."""
    return Intrinsics.from_fov(width=width, height=height, fov_rad=fov_rad)


def rigid_transform(name: str, transform: Any) -> Array:
    """Return a read-only copy of a rigid transform, 4x4, metres; `name` is what the message calls it.

    Raises:
        InvalidValueError: If it is not a 4x4 matrix of finite numbers, not a rotation and a translation, or its translation
            exceeds 100 m.
    """
    try:
        found = np.array(transform, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidValueError(name, transform, f"a 4x4 matrix of numbers ({error})") from error
    if found.shape != (4, 4):
        raise InvalidValueError(f"shape of {name}", found.shape, "(4, 4)")
    rotation = found[:3, :3]
    # Calibrated rotations are orthogonal to far better than 1e-6; scales and typing errors are not.
    with np.errstate(invalid="ignore", over="ignore"):
        orthogonal = (np.abs(rotation @ rotation.T - np.eye(3)) < 1e-6).all() and np.linalg.det(rotation) > 0.0
        near = np.abs(found[:3, 3]).max() <= _FARTHEST_M
    if not (orthogonal and near) or (found[3] != [0.0, 0.0, 0.0, 1.0]).any():
        allowed = f"a rigid transform: a rotation and a translation of at most {_FARTHEST_M:g} m"
        raise InvalidValueError(name, found.tolist(), allowed)
    found.flags.writeable = False
    return found


def invert_transform(a_from_b: Array) -> Array:
    """Invert a rigid 4x4 transform."""
    rotation = a_from_b[:3, :3]
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = rotation.T
    b_from_a[:3, 3] = -rotation.T @ a_from_b[:3, 3]
    return b_from_a


def transform_points(a_from_b: Array, points_in_b: Array) -> Array:
    """Map points (..., 3) from frame b to frame a."""
    return points_in_b @ a_from_b[:3, :3].T + a_from_b[:3, 3]
