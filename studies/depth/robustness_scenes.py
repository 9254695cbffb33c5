"""Frames outside of what networks were trained on, rendered on tissues of no data set, with exact truth."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_config import TissueConfig, TissueShape
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.optics.tissue_classes import TISSUE_CLASSES, tissue_material
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.geometry import Rig
from laploop.studies.depth.config import RobustnessConfig
from laploop.studies.scenes.frame_conditions import CameraPose, FrameRanges, draw_camera, draw_optics
from laploop.studies.scenes.training_scene import TrainingScene
from laploop.studies.scenes.unshaded import unshaded_image

Array = NDArray[np.float64]

NOMINAL, OTHER_TISSUE = "nominal", "other tissue"

CONDITIONS = {
    NOMINAL: "as in training, without the instrument",
    "phase shifted": "the mask shifted by a third of a period, which the model knows from the rig's calibration",
    "half power": "the LED at half its power",
    OTHER_TISSUE: "lobes of half, and of 1.7 times, the usual width and height, alternating",
    "tool in view": "the instrument close to the camera, covering about 30 % of the view",
    "saturated or dark": "40 % of the pixels saturated, or below 1 % of full scale, alternating",
    "liver": "light spreads under the surface as in liver, a tenth of it comes back, and the LED makes up for that",
    "fat": "the same for fat, of which six tenths come back, from as far as 10 mm aside",
    "ambient light": "other lights as well, as strong as a third of the beam",
    "no shading": "divided by what the same light gives without stripes: brightness tells nothing of distance and slope",
}
"""The conditions by name, and what each changes; everything else is drawn as for `nominal`, whose frame comes first."""

PHASE_SHIFT = 1.0 / 3.0
TOOL_FRACTION = 0.30
LOST_FRACTION = 0.40
AMBIENT_FRACTION = 1.0 / 3.0
"""Irradiance by other lights over the beam's on a facing surface at the working distance."""
_DARK = 0.01
"""Fraction of full scale below which a pixel counts as dark: 2.5 of 255 grey values."""
_STREAM = 173
"""Keeps these tissues and frames apart from those of data sets and theatres."""
_SEARCH_STEPS = 9
_TIP_DISTANCES_M = (0.010, 0.060)


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustnessFrame:
    """One image of one condition."""

    condition: str
    tissue: int
    rig: Rig
    image: NDArray[np.uint8]
    depth_mm: NDArray[np.float32]
    """Exact, NaN where nothing was hit."""
    lit: NDArray[np.bool_]
    """Where the projector reaches."""


def robustness_frames(config: RobustnessConfig, scope: ScopeOptics) -> Iterator[RobustnessFrame]:
    """Render all frames, tissue by tissue; the same frame of all conditions shares pose, light, surfaces and noise."""
    ranges = FrameRanges()
    shifted = replace(scope, mask=replace(scope.mask, phase=scope.mask.phase + PHASE_SHIFT))
    cameras = {name: StripeCamera(Rig.from_optics(optics)) for name, optics in (("scope", scope), ("shifted", shifted))}
    for tissue in range(config.tissues):
        shapes = {"usual": TissueShape(), "other": _other_family(tissue)}
        for kind, shape in shapes.items():
            scene = TrainingScene(TissueConfig(shape=shape), _rng(config, 0, tissue))
            conditions = [name for name in CONDITIONS if (name == OTHER_TISSUE) == (kind == "other")]
            for camera in cameras.values():
                camera.attach(scene.model, tissue=scene.tissue, rng=_rng(config, 1, tissue))
            for frame in range(config.frames_per_tissue):
                number = tissue * config.frames_per_tissue + frame
                for condition in conditions:
                    camera = cameras["shifted" if condition == "phase shifted" else "scope"]
                    yield _render(condition, number, scene, camera, ranges, config, tissue)


def _render(
    condition: str,
    number: int,
    scene: TrainingScene,
    camera: StripeCamera,
    ranges: FrameRanges,
    config: RobustnessConfig,
    tissue: int,
) -> RobustnessFrame:
    rng = _rng(config, 2, number)
    scene.reset()
    pose = draw_camera(ranges, scene.mean_height_m, rng)
    optics = draw_optics(ranges, pose.working_distance_m, rng)
    if condition == "half power":
        optics = replace(optics, led_power_w=0.5 * optics.led_power_w)
    elif condition == "tool in view":
        _cover_view(scene, camera, pose, _rng(config, 4, number))
    elif condition == "saturated or dark":
        camera.set_optics(optics)
        electrons = camera.capture(scene.data, pose.world_from_camera, None).electrons
        optics = _lose_pixels(optics, electrons, dark=bool(number % 2))
    elif condition in TISSUE_CLASSES:
        tissue_class = tissue_material(condition, surface=optics.tissue)
        power = optics.led_power_w * optics.tissue.albedo / tissue_class.albedo
        optics = replace(optics, led_power_w=power, tissue=tissue_class)
    elif condition == "ambient light":
        beam = optics.axial_intensity_w_sr(camera.rig.mask) / pose.working_distance_m**2
        optics = replace(optics, ambient_w_m2=AMBIENT_FRACTION * beam)
    camera.set_optics(optics)
    capture = camera.capture(scene.data, pose.world_from_camera, _rng(config, 3, number))
    image = capture.image
    if condition == "no shading":
        image = unshaded_image(camera, scene.data, pose.world_from_camera, _rng(config, 3, number))
    return RobustnessFrame(
        condition=condition, tissue=tissue, rig=camera.rig, image=image, depth_mm=capture.depth_mm, lit=capture.lit
    )


def _other_family(tissue: int) -> TissueShape:
    usual = TissueShape()
    factor = 0.5 if tissue % 2 == 0 else 1.7
    lobe_height = factor * usual.lobe_height_m
    return replace(
        usual,
        lobe_width_min_m=factor * usual.lobe_width_min_m,
        lobe_width_max_m=factor * usual.lobe_width_max_m,
        lobe_height_m=lobe_height,
        height_m=max(usual.height_m, usual.floor_m + lobe_height + 0.004),
    )


def _lose_pixels(optics: StripeOptics, electrons: NDArray[np.float32], *, dark: bool) -> StripeOptics:
    """Scale the light, with which the electrons grow in proportion, until `LOST_FRACTION` of the pixels is lost."""
    lit = electrons[electrons > 0.0]
    if dark:
        factor = _DARK * optics.full_well_electrons / float(np.quantile(lit, LOST_FRACTION))
    else:
        factor = optics.full_well_electrons / float(np.quantile(lit, 1.0 - LOST_FRACTION))
    return replace(optics, led_power_w=min(10.0, factor * optics.led_power_w))


def _cover_view(scene: TrainingScene, camera: StripeCamera, pose: CameraPose, rng: np.random.Generator) -> None:
    """Bring the instrument in from a random side, close enough to the camera to cover `TOOL_FRACTION` of the view."""
    rotation, centre = pose.world_from_camera[:3, :3], pose.world_from_camera[:3, 3]
    azimuth, tilt = rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(70.0, 85.0))
    side = np.array([math.cos(azimuth), math.sin(azimuth)])
    along = np.array([*(math.sin(tilt) * side), -math.cos(tilt)])
    near, far = _TIP_DISTANCES_M
    for _ in range(_SEARCH_STEPS):
        distance = 0.5 * (near + far)
        # The tip lies beyond the middle, so that the shaft crosses most of the view.
        tip_in_camera = distance * np.array([*(-0.3 * side), 1.0])
        scene.place_tool(centre + rotation @ tip_in_camera, -rotation @ along)
        covered = float(np.mean(camera.exact(scene.data, pose.world_from_camera).object_id == int(ObjectId.TOOL)))
        near, far = (distance, far) if covered > TOOL_FRACTION else (near, distance)


def _rng(config: RobustnessConfig, use: int, number: int) -> np.random.Generator:
    return np.random.default_rng([config.seed, _STREAM, use, number])
