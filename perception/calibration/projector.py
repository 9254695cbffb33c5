"""The stripe projector as an inverse camera: its pose and its stripes, from phases on planes."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.calibration.results import (
    MIN_VIEWS,
    CameraCalibration,
    check_view_count,
    check_view_errors,
    root_mean_square,
)
from laploop.perception.carrier import StripeCarrier
from laploop.perception.estimators.phase import PhaseEstimator
from laploop.perception.geometry import Rig, rigid_transform, transform_points

Array = NDArray[np.float64]

UNKNOWNS = ("x_m", "z_m", "pitch_rad", "yaw_rad", "roll_rad", "period_tan", "phase_turns")
"""What upright stripes reveal about a projector. Its offset along the stripes (y) is taken to be zero, as the channels lie side
by side."""

_SPACING_PX = 8
"""Between the pixels whose phase is used: phases of closer ones are read from nearly the same window."""
_MARGIN_PERIODS = 1.3
_MIN_CONTRAST = 0.08
_MAX_RESIDUAL = 0.5
_SATURATED = 253
_MIN_PIXELS = 50
_OUTLIER_TURNS = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class ProjectorCalibration:
    """A projector of upright stripes.

    A stripe is given in turns, bright stripes being centred at whole numbers: `turns = x / period_tan + phase_turns`, with x
    the tangent coordinate in the projector's frame. Whole turns cannot be distinguished.
    """

    projector_from_camera: Array
    """4x4, metres; the projector's centre has y = 0 in the camera's frame."""
    period_tan: float
    """Of the stripes, tangent units."""
    phase_turns: float
    """On the projector's axis, -0.5 to 0.5."""
    view_errors_turns: tuple[float, ...]
    """For each view of a plane, the root mean square misfit."""
    deviations: Mapping[str, float]
    """Standard deviation of each of `UNKNOWNS`, estimated from the misfits."""

    def __post_init__(self) -> None:
        check_view_errors("view_errors_turns", self.view_errors_turns)
        object.__setattr__(self, "projector_from_camera", rigid_transform("projector_from_camera", self.projector_from_camera))
        if not 0.0 < self.period_tan < 2.0:
            raise InvalidValueError("period_tan", self.period_tan, "above 0 and below 2")
        if not abs(self.phase_turns) <= 0.5:
            raise InvalidValueError("phase_turns", self.phase_turns, "-0.5 to 0.5")
        if set(self.deviations) != set(UNKNOWNS):
            raise InvalidValueError("names of deviations", sorted(self.deviations), f"{sorted(UNKNOWNS)}")
        if not all(math.isfinite(deviation) and deviation >= 0.0 for deviation in self.deviations.values()):
            raise InvalidValueError("deviations", dict(self.deviations), "finite numbers from 0 on")
        object.__setattr__(self, "deviations", MappingProxyType(dict(self.deviations)))

    @cached_property
    def centre_m(self) -> Array:
        """The projector's centre in the camera's frame, (3,)."""
        return np.asarray(-self.projector_from_camera[:3, :3].T @ self.projector_from_camera[:3, 3])

    @property
    def baseline_m(self) -> float:
        """Distance to the camera's right."""
        return float(self.centre_m[0])

    @property
    def error_turns(self) -> float:
        """Root mean square misfit over all views."""
        return root_mean_square(self.view_errors_turns)

    def turns(self, points_in_camera: Array) -> Array:
        """Return the stripe (...) that lights points (..., 3) in metres."""
        points = transform_points(self.projector_from_camera, points_in_camera)
        return np.asarray(points[..., 0] / points[..., 2] / self.period_tan + self.phase_turns)

    def depth_from_turns(self, rays: Array, turns: Array) -> Array:
        """Triangulate: z-depth in metres (...) along rays (..., 3) of z = 1 that show a stripe (...); NaN if diverging."""
        transform = self.projector_from_camera
        x = (turns - self.phase_turns) * self.period_tan
        denominator = x * (rays @ transform[2, :3]) - rays @ transform[0, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (transform[0, 3] - x * transform[2, 3]) / denominator
            return np.where((depth > 0.0) & np.isfinite(depth), depth, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibratedRig:
    """The parallel rig nearest to a calibration, for estimators that need one, and what it neglects."""

    rig: Rig
    misfit_turns: float
    """Root mean square difference of the two models' stripes over the image and the range of depths."""
    misfit_mm: float
    """The same as a depth error at 100 mm."""
    distortion_px: float
    """How far the lens, a pinhole in the rig, moves the corners of the image."""


def calibrate_projector(
    images: Sequence[NDArray[np.uint8]],
    camera_from_plane: Sequence[Array],
    half_extent_m: tuple[float, float],
    camera: CameraCalibration,
    nominal: Rig,
) -> ProjectorCalibration:
    """Estimate the projector from its stripes on a blank plane in several poses.

    The projector's model is fitted to the phase of each picture, read as by the classical estimator. Apart from a common shift,
    the nominal stripes may be off by at most half a turn.

    Args:
        images: Grey pictures (H, W) of a blank card, one for each pose.
        camera_from_plane: Poses (4, 4) of the card: its middle, z into it.
        half_extent_m: Half the card's width and height.
        camera: The calibrated camera.
        nominal: The scope's design: baseline and mask.

    Raises:
        InvalidValueError: If there are too few views, another number of poses, or too few pixels show stripes.
    """
    check_view_count(len(images))
    if len(camera_from_plane) != len(images):
        raise InvalidValueError("number of poses", len(camera_from_plane), f"{len(images)}, one an image")
    rig = replace(nominal, camera=camera.intrinsics)
    estimator, mask = PhaseEstimator(rig=rig), nominal.mask
    carrier = StripeCarrier(rig=rig).angle / (2.0 * np.pi)
    points: list[Array] = []
    measured: list[Array] = []
    for image, pose in zip(images, camera_from_plane, strict=True):
        found = _stripes_on_plane(image, pose, half_extent_m, camera, estimator, carrier)
        if len(found[0]) < _MIN_PIXELS:
            allowed = f"at least {_MIN_PIXELS}; is the card lit and in view?"
            raise InvalidValueError(f"pixels that show stripes in view {len(points)}", len(found[0]), allowed)
        points.append(found[0])
        measured.append(found[1])
    start = np.array([nominal.baseline_m, 0.0, 0.0, 0.0, 0.0, mask.period_tan, phase_of_mask(mask)])
    everywhere, turns = np.concatenate(points), np.concatenate(measured)
    # The mean difference on the unit circle is the common shift.
    shift = float(np.angle(np.exp(2j * np.pi * (turns - _turns(start, everywhere))).mean()) / (2.0 * np.pi))
    start[-1] += shift

    def misfit(values: Array) -> Array:
        difference = turns - _turns(values, everywhere)
        return difference - np.round(difference)

    scale = np.array([1e-3, 1e-3, 1e-2, 1e-2, 1e-2, 1e-3, 1e-1])
    solution: Any = least_squares(misfit, start, x_scale=scale, loss="soft_l1", f_scale=_OUTLIER_TURNS, jac="3-point")
    values, left = np.asarray(solution.x), misfit(np.asarray(solution.x))
    covariance = np.linalg.pinv(solution.jac.T @ solution.jac, hermitian=True, rcond=1e-18) * left.var()
    borders = np.cumsum([len(view) for view in points])[:-1]
    return ProjectorCalibration(
        projector_from_camera=_transform(values),
        period_tan=float(values[5]),
        phase_turns=float(values[6] - round(float(values[6]))),
        view_errors_turns=tuple(float(np.sqrt((part**2).mean())) for part in np.split(left, borders)),
        deviations=dict(zip(UNKNOWNS, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
    )


def phase_of_mask(mask: StripeMask) -> float:
    """Return a mask's turns on its axis, see `ProjectorCalibration`."""
    return mask.half_width_tan / mask.period_tan - mask.phase - 0.5 * mask.duty


def calibrated_rig(
    camera: CameraCalibration,
    projector: ProjectorCalibration,
    nominal: Rig,
    *,
    depths_m: tuple[float, float] = (0.07, 0.14),
) -> CalibratedRig:
    """Return the parallel rig whose stripes lie nearest to the calibrated ones in a range of depths, for estimators.

    Baseline, period and phase are fitted in turns over the whole image, evenly in inverse depth; the nominal mask gives stripe
    count and duty. A projector that is turned or stands ahead of the camera bends the stripes a little; the rig neglects that,
    and its size is returned. A parallel projector with the nominal stripes gives them back to the bit.
    """
    mask, k = nominal.mask, camera.intrinsics
    distortion_px = _distortion_px(camera)
    if _is_as_designed(projector, mask):
        rig = Rig(camera=k, baseline_m=projector.baseline_m, mask=mask)
        return CalibratedRig(rig=rig, misfit_turns=0.0, misfit_mm=0.0, distortion_px=distortion_px)
    inverse = np.linspace(1.0 / depths_m[1], 1.0 / depths_m[0], 8)
    rays = k.rays[::8, ::8].reshape(-1, 3)
    turns = projector.turns(rays / inverse[:, None, None])
    x = np.broadcast_to(rays[:, 0], turns.shape)
    columns = np.stack([x, np.broadcast_to(-inverse[:, None], turns.shape), np.ones_like(turns)], axis=-1).reshape(-1, 3)
    frequency, over_depth, phase = np.linalg.lstsq(columns, turns.ravel(), rcond=None)[0]
    misfit = float(np.sqrt(((columns @ [frequency, over_depth, phase] - turns.ravel()) ** 2).mean()))
    half_width = 0.5 * mask.stripes / frequency
    fitted = replace(
        mask,
        fov_rad=2.0 * math.atan(half_width),
        phase=float(np.mod(half_width * frequency - 0.5 * mask.duty - phase, 1.0)),
    )
    return CalibratedRig(
        rig=Rig(camera=k, baseline_m=float(over_depth / frequency), mask=fitted),
        misfit_turns=misfit,
        misfit_mm=misfit * 1e3 * 0.1**2 / float(over_depth),
        distortion_px=distortion_px,
    )


def designed_projector(rig: Rig) -> ProjectorCalibration:
    """Return the calibration of a projector that is just as a rig's design has it, without any error."""
    phase = phase_of_mask(rig.mask)
    return ProjectorCalibration(
        projector_from_camera=rig.projector_from_camera,
        period_tan=rig.mask.period_tan,
        phase_turns=phase - round(phase),
        view_errors_turns=(0.0,) * MIN_VIEWS,
        deviations=dict.fromkeys(UNKNOWNS, 0.0),
    )


def _is_as_designed(projector: ProjectorCalibration, mask: StripeMask) -> bool:
    parallel = np.eye(4)
    parallel[0, 3] = projector.projector_from_camera[0, 3]
    phase = phase_of_mask(mask)
    same_stripes = (projector.period_tan, projector.phase_turns) == (mask.period_tan, phase - round(phase))
    return same_stripes and np.array_equal(projector.projector_from_camera, parallel)


def _distortion_px(camera: CameraCalibration) -> float:
    """Return how far the lens moves the corners of the image."""
    k = camera.intrinsics
    edge_x, edge_y = np.moveaxis(k.rays[:: k.height - 1, :: k.width - 1, :2], -1, 0)
    on_lens_x, on_lens_y = camera.distortion.apply(edge_x, edge_y)
    return float(np.hypot(k.fx * (on_lens_x - edge_x), k.fy * (on_lens_y - edge_y)).max())


def _stripes_on_plane(
    image: NDArray[np.uint8],
    pose: Array,
    half_extent_m: tuple[float, float],
    camera: CameraCalibration,
    estimator: PhaseEstimator,
    carrier: Array,
) -> tuple[Array, Array]:
    """Return points of a plane (n, 3) in the camera's frame and the stripes seen there (n,), in fractions of a turn."""
    mask, k = estimator.rig.mask, camera.intrinsics
    seen = estimator.demodulate(image)
    rays = camera.undistorted_rays()
    normal = pose[:3, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = rays * ((normal @ pose[:3, 3]) / (rays @ normal))[..., None]
        on_plane = (points - pose[:3, 3]) @ pose[:3, :3]
        on_mask = rays[..., 0] - estimator.rig.baseline_m / points[..., 2]
    # Near the ends of the card, the image and the light, the window reaches beyond them.
    margin_m = _MARGIN_PERIODS * mask.period_tan * points[..., 2]
    good = (points[..., 2] > 0.0) & (np.abs(on_mask) < mask.half_width_tan - _MARGIN_PERIODS * mask.period_tan)
    for axis in range(2):
        good &= np.abs(on_plane[..., axis]) < half_extent_m[axis] - margin_m
    margin_px = math.ceil(_MARGIN_PERIODS * mask.period_tan * k.fx)
    good[:, :margin_px] = good[:, -margin_px:] = False
    good[:margin_px] = good[-margin_px:] = False
    good &= (seen.contrast >= _MIN_CONTRAST) & (seen.residual <= _MAX_RESIDUAL) & (image < _SATURATED)
    chosen = np.zeros_like(good)
    chosen[::_SPACING_PX, ::_SPACING_PX] = True
    good &= chosen
    turns = carrier - seen.fraction
    return points[good], turns[good].astype(np.float64)


def _transform(values: Array) -> Array:
    """Return projector_from_camera of a vector of unknowns."""
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", values[2:5]).as_matrix()
    transform[:3, 3] = -transform[:3, :3] @ [values[0], 0.0, values[1]]
    return transform


def _turns(values: Array, points: Array) -> Array:
    in_projector = transform_points(_transform(values), points)
    turns: Array = in_projector[:, 0] / in_projector[:, 2] / values[5] + values[6]
    return turns
