"""Visibility of the projected stripes against working distance, measured as on a bench: on a depth-of-field target."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from laploop.assets.dof_target import DepthOfFieldTarget
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.presets import optics_preset
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Intrinsics, Rig
from laploop.studies.characterization.config import FIGURE_DISTANCES_MM, CharacterizationConfig
from laploop.studies.csv_text import csv_text

_ROI_SCALE_MM = (5.0, 45.0)
_ROI_HALF_HEIGHT_MM = 4.0
_BRIGHTEST = 0.9
_MIN_SPACING = 0.6
_MIN_PROMINENCE = 0.03

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RegionOfInterest:
    """A rectangle of pixels; right and bottom are exclusive."""

    left: int
    right: int
    top: int
    bottom: int


@dataclass(frozen=True, kw_only=True, eq=False)
class StripeProfile:
    """Grey values along the target's scale."""

    distance_mm: int
    roi: RegionOfInterest
    image: NDArray[np.uint8]
    """(H, W), the image it was taken from."""
    scale_mm: Array
    """(n,), where each column of the region meets the target's scale."""
    mean: Array
    """(n,), over the rows of the region."""
    spread: Array
    """(n,), standard deviation over the rows."""
    peaks: NDArray[np.intp]
    valleys: NDArray[np.intp]
    contrast: float
    """Michelson contrast, see `michelson_contrast`; NaN where there are too few stripes."""

    @property
    def mean_intensity(self) -> float:
        """Mean grey value of the region."""
        return float(self.mean.mean())


@dataclass(frozen=True, kw_only=True, eq=False)
class Characterization:
    """The measured profiles."""

    profiles: tuple[StripeProfile, ...]
    """Nearest distance first."""
    reference: NDArray[np.uint8]
    """(H, W), the target at the larger of the figure's distances through a clear mask, with more pixels."""
    exposure_s: float
    """The same for all distances."""

    def at(self, distance_mm: int) -> StripeProfile:
        """Return the profile of a distance that was measured."""
        return next(profile for profile in self.profiles if profile.distance_mm == distance_mm)

    def as_dict(self) -> dict[str, object]:
        """Return the numbers of the summary."""
        return {
            "contrast": {str(distance): self.at(distance).contrast for distance in FIGURE_DISTANCES_MM},
            "contrast_by_distance": {str(profile.distance_mm): profile.contrast for profile in self.profiles},
            "mean_intensity_by_distance": {str(profile.distance_mm): profile.mean_intensity for profile in self.profiles},
            "exposure_s": self.exposure_s,
        }


def characterise(config: CharacterizationConfig, progress: Callable[[float], None] | None = None) -> Characterization:
    """Image the target at every distance and measure the stripes on its blank part.

    The exposure is set once, to 0.9 of full scale in the region at the nearest distance, and kept: how the intensity falls with
    distance is part of the result. `progress` is called with the number of distances done.
    """
    rig, target = Rig.from_optics(config.optics), DepthOfFieldTarget()
    distances = config.measured_mm
    camera = StripeCamera(rig, optics_preset(config.preset))
    scene = _scene(target)
    camera.attach_geometry(scene)
    optics = _exposed(camera, scene, target, distances[0])
    camera.set_optics(optics)
    rng = np.random.default_rng(config.seed)
    profiles = []
    for done, distance in enumerate(distances, start=1):
        _move(scene, target, distance)
        image = camera.capture(None, np.eye(4), rng).image
        profiles.append(measure_profile(image, rig, target, distance))
        if progress is not None:
            progress(done)
    reference = _reference(config, optics, target)
    return Characterization(profiles=tuple(profiles), reference=reference, exposure_s=optics.exposure_s)


def measure_profile(image: NDArray[np.uint8], rig: Rig, target: DepthOfFieldTarget, distance_mm: int) -> StripeProfile:
    """Measure the stripes on the blank part of a target whose middle mark is on the camera's axis."""
    roi = region_of_interest(rig.camera, target, distance_mm)
    grey = image[roi.top : roi.bottom, roi.left : roi.right].astype(np.float64)
    mean = grey.mean(axis=0)
    period_px = rig.mask.period_tan * rig.camera.fx
    peaks, valleys = find_extrema(mean, _MIN_SPACING * period_px)
    return StripeProfile(
        distance_mm=distance_mm,
        roi=roi,
        image=image,
        scale_mm=scale_of_columns(rig.camera, target, distance_mm, np.arange(roi.left, roi.right) + 0.5),
        mean=mean,
        spread=grey.std(axis=0),
        peaks=peaks,
        valleys=valleys,
        contrast=michelson_contrast(mean, peaks, valleys),
    )


def region_of_interest(camera: Intrinsics, target: DepthOfFieldTarget, distance_mm: int) -> RegionOfInterest:
    """Return the pixels that see the blank part from 5 to 45 mm of the scale, 8 mm high at the middle mark's distance."""
    along = np.array(_ROI_SCALE_MM) - target.centre_mm
    u = camera.fx * along * math.cos(target.tilt_rad) / (distance_mm + along * math.sin(target.tilt_rad)) + camera.cx
    half = camera.fy * _ROI_HALF_HEIGHT_MM / distance_mm
    roi = RegionOfInterest(
        left=math.ceil(u[0]), right=math.floor(u[1]), top=math.ceil(camera.cy - half), bottom=math.floor(camera.cy + half)
    )
    if roi.left < 0 or roi.right > camera.width:
        raise InvalidValueError("distance_mm", distance_mm, "far enough for the target's scale to be in view")
    return roi


def scale_of_columns(camera: Intrinsics, target: DepthOfFieldTarget, distance_mm: float, u: NDArray[np.floating]) -> Array:
    """Return where the columns of an image, in pixels, meet the target's scale, in its millimetres."""
    ray = (u - camera.cx) / camera.fx
    x = ray * distance_mm / (1.0 - ray * math.tan(target.tilt_rad))
    return np.asarray(x / math.cos(target.tilt_rad) + target.centre_mm)


def find_extrema(profile: Array, least_spacing: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of the peaks and of the valleys; those at the ends of the profile do not count.

    An extremum counts if it stands out by 3 % of the largest value and no larger one is nearer than `least_spacing` samples.
    """
    prominence = _MIN_PROMINENCE * float(profile.max(initial=0.0))
    spacing = max(least_spacing, 1.0)
    peaks, _ = find_peaks(profile, distance=spacing, prominence=prominence)
    valleys, _ = find_peaks(-profile, distance=spacing, prominence=prominence)
    return peaks, valleys


def michelson_contrast(profile: Array, peaks: NDArray[np.intp], valleys: NDArray[np.intp]) -> float:
    """Return the mean of (P - V) / (P + V) over all extrema that have one of the other kind on either side.

    At a valley, V is the profile there and P the line through the peaks on both sides of it; at a peak the other way round.
    The brightness, which falls along an inclined target, thus cancels. Values are samples, not a fitted curve. NaN where no
    extremum lies between two others.
    """
    found: list[float] = []
    for inner, outer in ((valleys, peaks), (peaks, valleys)):
        if len(outer) < 2:
            continue
        between = inner[(inner > outer[0]) & (inner < outer[-1])]
        here, there = profile[between], np.interp(between, outer, profile[outer])
        found += (np.abs(there - here) / (there + here)).tolist()
    return float(np.mean(found)) if found else math.nan


def as_csv(found: Characterization) -> str:
    """Return a row for each distance."""
    header = ("distance_mm", "contrast", "mean_intensity", "spread_over_width", "peaks", "valleys")
    rows = [
        (p.distance_mm, f"{p.contrast:.4f}", f"{p.mean_intensity:.2f}", f"{p.spread.mean():.2f}", len(p.peaks), len(p.valleys))
        for p in found.profiles
    ]
    return csv_text(header, rows)


def profiles_as_csv(found: Characterization) -> str:
    """Return a row for each column of the region at each distance."""
    rows = [
        (profile.distance_mm, f"{scale:.3f}", f"{mean:.3f}", f"{spread:.3f}")
        for profile in found.profiles
        for scale, mean, spread in zip(profile.scale_mm, profile.mean, profile.spread, strict=True)
    ]
    return csv_text(("distance_mm", "scale_mm", "mean_intensity", "spread"), rows)


def as_markdown(found: Characterization) -> str:
    """Return the table of contrast and intensity by distance."""
    lines = ["| distance [mm] | Michelson contrast | mean intensity [grey values] |", "|---:|---:|---:|"]
    lines += [f"| {p.distance_mm} | {p.contrast:.3f} | {p.mean_intensity:.1f} |" for p in found.profiles]
    return "\n".join(lines) + "\n"


def _scene(target: DepthOfFieldTarget) -> SceneGeometry:
    surface = target.surface()
    return SceneGeometry(
        points=surface.points, triangles=surface.triangles, object_ids=ObjectId.OTHER, albedo_factor=surface.albedo_factor
    )


def _move(scene: SceneGeometry, target: DepthOfFieldTarget, distance_mm: float) -> None:
    """Put the target before a camera at the world's origin."""
    pose = target.camera_from_target(1e-3 * distance_mm)
    scene.move(target.surface().points @ pose[:3, :3].T + pose[:3, 3])


def _exposed(camera: StripeCamera, scene: SceneGeometry, target: DepthOfFieldTarget, distance_mm: int) -> StripeOptics:
    """Return the camera's optics with the exposure that puts the region at a distance at 0.9 of full scale."""
    _move(scene, target, distance_mm)
    roi = region_of_interest(camera.rig.camera, target, distance_mm)
    electrons = camera.capture(None, np.eye(4), None).electrons[roi.top : roi.bottom, roi.left : roi.right]
    gain = _BRIGHTEST * camera.optics.full_well_electrons / float(electrons.max())
    return replace(camera.optics, exposure_s=camera.optics.exposure_s * gain)


def _reference(config: CharacterizationConfig, optics: StripeOptics, target: DepthOfFieldTarget) -> NDArray[np.uint8]:
    """Return the target without stripes, at the larger of the figure's distances, without noise."""
    distance = FIGURE_DISTANCES_MM[-1]
    mask = StripeMask(stripes=config.optics.mask.stripes, profile=(1.0,), fov_rad=config.optics.mask.fov_rad)
    size = {"width": 2 * config.optics.width, "height": 2 * config.optics.height}
    rig = Rig.from_optics(replace(config.optics, mask=mask, **size))
    camera, scene = StripeCamera(rig, optics), _scene(target)
    camera.attach_geometry(scene)
    camera.set_optics(_exposed(camera, scene, target, distance))
    return camera.capture(None, np.eye(4), None).image
