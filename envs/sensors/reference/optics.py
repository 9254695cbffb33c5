"""The reference camera as numbers: a Zivid 2+ M60, its projector and its errors."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import Field, configuration
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import OTHER, STAGE, TISSUE, TOOL, Fraction, LensBlur, Material
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, Rig

Sampling = Literal["full", "2x2", "4x4"]
_STEPS: dict[Sampling, int] = {"full": 1, "2x2": 2, "4x4": 4}

_TINTS = {
    ObjectId.TISSUE: (1.45, 0.80, 0.75),
    ObjectId.TOOL: (0.97, 1.0, 1.03),
    ObjectId.STAGE: (0.97, 1.0, 1.03),
    ObjectId.OTHER: (1.0, 1.0, 1.0),
}
"""Red, green and blue relative to the albedo, of mean 1; they only colour the picture."""

Pixels = Annotated[int, Field(ge=16, le=8192, multiple_of=4)]
Start = Annotated[int, Field(ge=0, le=8192)]
Size = Annotated[int, Field(ge=16, le=8192)]
HalfWidth = Annotated[float, Field(ge=0.03, le=2.0)]
Distance = Annotated[float, Field(ge=0.0, le=10.0)]
Millimetres = Annotated[float, Field(ge=0.0, le=10.0)]


@dataclass(frozen=True, kw_only=True)
class ConvergingRig(Rig):
    """A camera and a projector to its right, `forward_m` ahead and turned by `yaw_rad` towards the camera's axis."""

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


@configuration
class ReferenceOptics:
    """Geometry, errors and limits of the reference camera.

    Geometry is that of the manufacturer's Isaac Sim extension (zivid-isaac-sim, `camera_calibration.py`, `resolution.py`);
    noise and trueness are of the data sheet at 600 mm. What has no source there (signal-to-noise ratio, highlights, picture)
    is an estimate. `ideal` switches all errors off; zeros switch them off one by one.
    """

    sampling: Sampling = "2x2"
    """A point for each sensor pixel, or for each square of 4 or 16 of them."""
    width: Pixels = 2448
    """Columns of the camera's image."""
    height: Pixels = 2048
    """Rows of the camera's image."""
    focal_px: Annotated[float, Field(ge=10.0, le=1e5)] = 2481.0
    """Sizes and focal length at full sampling; the principal point is the middle."""
    region: tuple[Start, Start, Size, Size] | None = None
    """Region of interest: column and row of its first pixel, width and height, in pixels of the sampling; none is the whole
    image. Points outside are not computed; those inside change only by the order of the random numbers."""
    baseline_m: Annotated[float, Field(ge=0.001, le=1.0)] = 0.1112
    """From the camera's centre to the projector's."""
    projector_forward_m: Annotated[float, Field(ge=-0.2, le=0.2)] = 0.0079
    """How far the projector's centre is in front of the camera's."""
    projector_yaw_rad: Annotated[float, Field(ge=-1.0, le=1.0)] = 0.085
    """The projector stands to the right (+x) and ahead of the camera, turned towards the camera's axis."""
    projector_half_width_tan: HalfWidth = 500.0 / 932.0
    """Tangent of half the projector's field of view."""
    projector_half_height_tan: HalfWidth = 360.0 / 932.0
    """Half of the projector's field, 1000 x 720 pixels at a focal length of 932."""
    near_m: Distance = 0.3
    """Near end of the working range, z-depth."""
    far_m: Distance = 1.1
    """Working range, z-depth; nothing is measured outside it."""
    point_noise_mm: Millimetres = 0.08
    """Standard deviation of z at 600 mm, for a facing surface of the reference albedo; proportional to the distance."""
    dimension_trueness: Annotated[float, Field(ge=0.0, le=0.05)] = 0.002
    """Bound of a camera's constant scale error."""
    planarity_trueness_mm: Millimetres = 0.1
    """Bound of a camera's constant smooth bend of a plane."""
    unit_seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Draws the scale error and the bend: which camera of the series this is."""
    reference_albedo: Annotated[float, Field(ge=0.01, le=1.0)] = 0.4
    """Albedo of the surface for which noise and saturation are given."""
    snr_reference: Annotated[float, Field(ge=1.0, le=1e4)] = 35.0
    """Signal-to-noise ratio of a facing surface of the reference albedo; exposures follow the distance."""
    snr_min: Annotated[float, Field(ge=0.0, le=1e4)] = 7.0
    """Points with a lower ratio are removed."""
    saturation_ratio: Annotated[float, Field(ge=0.5, le=1e3)] = 2.5
    """Radiance at which the sensor saturates, relative to a facing matte surface of the reference albedo."""
    saturated_is_missing: bool = True
    """Whether saturated pixels have no point."""
    needs_projector: bool = True
    """Whether points that the projector does not reach are missing, as with a camera of this kind."""
    ambient_fraction: Fraction = 0.05
    """Light in the colour picture that does not come from the projector, relative to the projector's."""
    normal_window_px: Annotated[int, Field(ge=3, le=31)] = 5
    """Side, an odd number, of the square of points that a normal is fitted to; sets the noise of the normals."""
    lens_blur_px: LensBlur = 0.5
    """Standard deviation of the colour picture's blur, in pixels of full sampling."""
    colour_noise: Annotated[float, Field(ge=0.0, le=0.5)] = 0.004
    """Standard deviation of the colour picture's noise, as a fraction of full scale."""
    tissue: Material = TISSUE
    tool: Material = TOOL
    stage: Material = STAGE
    other: Material = OTHER

    def __post_init__(self) -> None:
        if not self.near_m <= self.far_m:
            raise InvalidValueError("far_m", self.far_m, f"near_m, {self.near_m:g}, to 10")
        if not self.snr_min <= self.snr_reference:
            raise InvalidValueError("snr_min", self.snr_min, f"0 to snr_reference, {self.snr_reference:g}")
        if self.normal_window_px % 2 == 0:
            raise InvalidValueError("normal_window_px", self.normal_window_px, "an odd number from 3 to 31")
        if self.region is not None:
            column, row, width, height = self.region
            image_width, image_height = self.width // self.step, self.height // self.step
            if column + width > image_width or row + height > image_height:
                allowed = f"column, row, width, height inside {image_width} x {image_height} pixels"
                raise InvalidValueError("region", self.region, allowed)

    def ideal(self) -> "ReferenceOptics":
        """Return the same camera without errors: only points hidden from it or its projector are missing."""
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

    @property
    def step(self) -> int:
        """Sensor pixels along the side of the square that makes one point."""
        return _STEPS[self.sampling]

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Captured window: column and row of its first pixel, width and height, in pixels of the sampling."""
        return self.region or (0, 0, self.width // self.step, self.height // self.step)

    @cached_property
    def intrinsics(self) -> Intrinsics:
        """Intrinsics at the sampling, for the region of interest."""
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
        """Camera and projector; the mask is the square around the projector's field."""
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
