"""The reference camera as numbers: a Zivid 2+ M60, its projector and its errors."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import OTHER, STAGE, TISSUE, TOOL, Material
from laploop.errors import InvalidValueError, UnknownNameError, check_range
from laploop.perception.geometry import Intrinsics, Rig

SAMPLINGS: Mapping[str, int] = MappingProxyType({"full": 1, "2x2": 2, "4x4": 4})
"""Names of the samplings, and how many sensor pixels along a side make one point."""

_TINTS = {
    ObjectId.TISSUE: (1.45, 0.80, 0.75),
    ObjectId.TOOL: (0.97, 1.0, 1.03),
    ObjectId.STAGE: (0.97, 1.0, 1.03),
    ObjectId.OTHER: (1.0, 1.0, 1.0),
}
"""Red, green and blue over the albedo, of mean 1; they only colour the picture."""


@dataclass(frozen=True, kw_only=True)
class ConvergingRig(Rig):
    """A camera and a projector to its right that also stands `forward_m` ahead and is turned by `yaw_rad` towards its axis."""

    forward_m: float = 0.0
    yaw_rad: float = 0.0

    @property
    def projector_from_camera(self) -> NDArray[np.float64]:
        """Rigid transform, 4x4, metres."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        # The columns of camera_from_projector's rotation are the projector's axes; its z axis leans to the camera's -x.
        rotation = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]).T
        transform = np.eye(4)
        transform[:3, :3] = rotation
        transform[:3, 3] = -rotation @ [self.baseline_m, 0.0, self.forward_m]
        return transform

    def projector_x(self, depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Tangent coordinate in the projector that lights each camera pixel, (H, W), for z-depth (H, W) in metres."""
        transform = self.projector_from_camera
        x, z = (self.camera.rays @ transform[row, :3] * depth_m + transform[row, 3] for row in (0, 2))
        return np.asarray(x / z)

    def depth_from_projector_x(self, projector_x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Triangulate: z-depth in metres, (H, W), from the projector's coordinate at each pixel; NaN where rays diverge."""
        transform = self.projector_from_camera
        numerator = transform[0, 3] - projector_x * transform[2, 3]
        denominator = projector_x * (self.camera.rays @ transform[2, :3]) - self.camera.rays @ transform[0, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = numerator / denominator
            return np.where((depth > 0.0) & np.isfinite(depth), depth, np.nan)


@dataclass(frozen=True, kw_only=True)
class ReferenceOptics:
    """Geometry, errors and limits of the reference camera.

    Geometry is that of the maker's own Isaac Sim extension (zivid-isaac-sim, `camera_calibration.py`, `resolution.py`); noise
    and trueness are of the data sheet at 600 mm. What has no source there (signal-to-noise ratio, highlights, picture) is an
    estimate. `ideal` switches all errors off; each can be switched off alone by a zero.
    """

    sampling: str = "2x2"
    """"full", "2x2" or "4x4": a point for each sensor pixel, or for each square of 4 or 16 of them."""
    width: int = 2448
    height: int = 2048
    focal_px: float = 2481.0
    """Sizes and focal length at full sampling; the principal point is the middle."""
    region: tuple[int, int, int, int] | None = None
    """Region of interest: column and row of its first pixel, width and height, in pixels of the sampling; None is the whole
    image. Points outside it are not computed; inside it nothing changes but the order of the random numbers."""
    baseline_m: float = 0.1112
    projector_forward_m: float = 0.0079
    projector_yaw_rad: float = 0.085
    """The projector stands to the right (+x) and ahead of the camera, turned towards the camera's axis."""
    projector_half_width_tan: float = 500.0 / 932.0
    projector_half_height_tan: float = 360.0 / 932.0
    """Half of the projector's field, 1000 x 720 pixels at a focal length of 932."""
    near_m: float = 0.3
    far_m: float = 1.1
    """Working range, z-depth; beyond it nothing is measured."""
    point_noise_mm: float = 0.08
    """Standard deviation of z at 600 mm, for a facing surface of the reference albedo; proportional to the distance."""
    dimension_trueness: float = 0.002
    """Bound of the scale error that a camera has for its life."""
    planarity_trueness_mm: float = 0.1
    """Bound of the smooth bend that a camera shows on a plane, for its life."""
    unit_seed: int = 0
    """Which camera of the series this is: draws its scale error and its bend."""
    reference_albedo: float = 0.4
    snr_reference: float = 35.0
    """Signal-to-noise ratio of a facing surface of the reference albedo; exposures follow the distance."""
    snr_min: float = 7.0
    """Points with less are removed."""
    saturation_ratio: float = 2.5
    """Radiance at which the sensor saturates, over that of a facing matte surface of the reference albedo."""
    saturated_is_missing: bool = True
    needs_projector: bool = True
    """Whether points that the projector does not reach are missing, as they are in a camera of this kind."""
    ambient_fraction: float = 0.05
    """Light in the colour picture that does not come from the projector, over the projector's."""
    normal_window_px: int = 5
    """Side of the square of points that a normal is fitted to; sets the noise of the normals."""
    lens_blur_px: float = 0.5
    """Standard deviation of the colour picture's blur, in pixels of full sampling."""
    colour_noise: float = 0.004
    """Standard deviation of the colour picture's noise, as a fraction of full scale."""
    tissue: Material = field(default=TISSUE)
    tool: Material = field(default=TOOL)
    stage: Material = field(default=STAGE)
    other: Material = field(default=OTHER)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            UnknownNameError: If there is no such sampling.
            InvalidValueError: If a field lies outside its range.
        """
        if self.sampling not in SAMPLINGS:
            raise UnknownNameError("sampling", self.sampling, SAMPLINGS)
        for name in ("width", "height"):
            size = getattr(self, name)
            if not 16 <= size <= 8192 or size % 4:
                raise InvalidValueError(name, size, "a multiple of 4 from 16 to 8192")
        self._check_region()
        if self.unit_seed < 0:
            raise InvalidValueError("unit_seed", self.unit_seed, "an integer from 0")
        if not 3 <= self.normal_window_px <= 31 or self.normal_window_px % 2 == 0:
            raise InvalidValueError("normal_window_px", self.normal_window_px, "an odd number from 3 to 31")
        for name, low, high in (
            ("focal_px", 10.0, 1e5),
            ("baseline_m", 0.001, 1.0),
            ("projector_forward_m", -0.2, 0.2),
            ("projector_yaw_rad", -1.0, 1.0),
            ("projector_half_width_tan", 0.01, 2.0),
            ("projector_half_height_tan", 0.01, 2.0),
            ("near_m", 0.0, 10.0),
            ("far_m", self.near_m, 10.0),
            ("point_noise_mm", 0.0, 10.0),
            ("dimension_trueness", 0.0, 0.05),
            ("planarity_trueness_mm", 0.0, 10.0),
            ("reference_albedo", 0.01, 1.0),
            ("snr_reference", 1.0, 1e4),
            ("snr_min", 0.0, self.snr_reference),
            ("saturation_ratio", 0.5, 1e3),
            ("ambient_fraction", 0.0, 1.0),
            ("lens_blur_px", 0.0, 10.0),
            ("colour_noise", 0.0, 0.5),
        ):
            check_range(name, getattr(self, name), low, high)

    def ideal(self) -> "ReferenceOptics":
        """Return the same camera without errors: only what it or its projector cannot see is missing."""
        return replace(
            self,
            point_noise_mm=0.0,
            dimension_trueness=0.0,
            planarity_trueness_mm=0.0,
            snr_min=0.0,
            saturated_is_missing=False,
            lens_blur_px=0.0,
            colour_noise=0.0,
        )

    def _check_region(self) -> None:
        """Raise unless the region lies in the image."""
        if self.region is None:
            return
        # What came from JSON is a list; optics stay hashable and equal to what was written.
        object.__setattr__(self, "region", tuple(self.region))
        whole = (self.width // self.step, self.height // self.step)
        inside = len(self.region) == 4 and all(
            start >= 0 and size >= 16 and start + size <= end
            for start, size, end in zip(self.region[:2], self.region[2:], whole, strict=True)
        )
        if not inside:
            allowed = f"column, row, width, height inside {whole[0]} x {whole[1]} pixels, at least 16 x 16"
            raise InvalidValueError("region", self.region, allowed)

    @property
    def step(self) -> int:
        """How many sensor pixels along a side make one point."""
        return SAMPLINGS[self.sampling]

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Column and row of the first pixel, width and height of what is captured, in pixels of the sampling."""
        return self.region or (0, 0, self.width // self.step, self.height // self.step)

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """Of the camera at its sampling, in its region of interest."""
        step = self.step
        column, row, width, height = self.window
        return Intrinsics(
            width=width,
            height=height,
            fx=self.focal_px / step,
            fy=self.focal_px / step,
            cx=0.5 * self.width / step - column,
            cy=0.5 * self.height / step - row,
        )

    @cached_property
    def rig(self) -> ConvergingRig:
        """Camera and projector; the mask stands for the square around the projector's field."""
        half = max(self.projector_half_width_tan, self.projector_half_height_tan)
        return ConvergingRig(
            camera=self.intrinsics,
            baseline_m=self.baseline_m,
            forward_m=self.projector_forward_m,
            yaw_rad=self.projector_yaw_rad,
            mask=StripeMask(fov_rad=2.0 * math.atan(half)),
        )

    @cached_property
    def material_table(self) -> NDArray[np.float32]:
        """One row an `ObjectId`: albedo, reflectance, roughness, and the tint's red, green and blue."""
        rows = np.zeros((len(ObjectId), 6), dtype=np.float32)
        rows[:, 2] = 1.0
        for object_id, tint in _TINTS.items():
            material: Material = getattr(self, object_id.name.lower())
            rows[object_id] = material.albedo, material.reflectance, material.roughness, *tint
        return rows
