"""What depth networks cost under light that the stripe camera leaves out: the same organs, rendered by the path tracer."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.families.registry import family_named
from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.stripe_capture import StripeCapture
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.twin.config import LightConfig
from laploop.studies.twin.render import check_mitsuba, render_twin
from laploop.studies.twin.scene import height_field, joined, twin_optics, with_vessels

_NEAREST_M = 0.075
"""From the camera to the organ's nearest point."""
_WALL_M = 0.030
"""From the organ's farthest point to the wall behind it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Light:
    """A way to light a scene that differs from the nominal one in one thing."""

    name: str
    optics: StripeOptics
    bounces: int = 1
    """Surfaces that light meets on its way at most."""
    vessels: bool = False
    """Whether vessels with sharp rims are painted on."""


def lights() -> tuple[Light, ...]:
    """Return the lights: first the nominal one, then what the path tracer adds to it, one by one.

    The dipole has mu_s' 1 and mu_a 0.2 per millimetre, as of tissue rich in blood. Stray light that is confined to where the
    beam shines has the power that the nominal optics give to glare and cavity together.
    """
    optics = twin_optics()
    dipole = Subsurface(profile="dipole", reduced_scattering_per_m=1000.0, absorption_per_m=200.0)
    stray = optics.glare_fraction + StripeOptics().cavity_fraction * optics.tissue.albedo
    return (
        Light(name="nominal", optics=optics),
        Light(name="dipole", optics=replace(optics, tissue=replace(optics.tissue, subsurface=dipole))),
        Light(name="vessels", optics=optics, vessels=True),
        Light(name="gamma 2.2", optics=replace(optics, response=CameraResponse(gamma=2.2))),
        Light(name="confined stray light", optics=replace(optics, glare_fraction=stray)),
        Light(name="interreflection", optics=optics, bounces=4),
    )


def measure_light(config: LightConfig, progress: Callable[[float], None] | None = None) -> list[dict[str, Any]]:
    """Measure the estimators' error on every organ under every light.

    Args:
        config: What to measure.
        progress: Called with the number of images done.

    Returns:
        A row for each estimator and light: `mae_mm` over the lit pixels of all organs in the working range, and `ratio`, that
        to the error on the stripe camera's own images, which the row with the light `stripe camera` has.

    Raises:
        InvalidValueError: If Mitsuba or scikit-image is not installed.
        UnknownNameError: If there is no such estimator or family.
    """
    check_mitsuba()
    rig = Rig.from_optics(ScopeOptics())
    estimators = {name: make_estimator(name, rig) for name in config.models}
    families = [family_named(name) for name in config.organs]
    errors: dict[tuple[str, str], list[Array]] = {}
    done = 0
    for number, family in enumerate(families):
        scene = _organ_scene(family.build(np.random.default_rng([config.seed, number])))
        nominal = _captured(rig, StripeOptics(), scene, np.random.default_rng([config.seed, number, 1]))
        pixels = nominal.lit & _within(nominal.depth_mm, WORKING_RANGE_MM)
        images = {"stripe camera": nominal.image}
        for light in lights():
            images[light.name] = _traced_image(rig, light, scene, config, number)
            done += 1
            if progress is not None:
                progress(done)
        for light_name, image in images.items():
            for name, found in _errors(estimators, image, nominal.depth_mm, pixels).items():
                errors.setdefault((name, light_name), []).append(found)
    return _rows(errors)


def count_images(config: LightConfig) -> int:
    """Return how many images the path tracer renders."""
    return len(config.organs) * len(lights())


def _organ_scene(organ: AnatomyMesh) -> SceneGeometry:
    """Put an organ, with z up, before the camera, and a wall behind it."""
    points = organ.points * [1.0, -1.0, -1.0]
    points[:, 2] += _NEAREST_M - points[:, 2].min()
    distance = float(points[:, 2].max()) + _WALL_M
    wall = height_field(lambda x, _: np.full_like(x, distance), object_id=ObjectId.TISSUE, half_m=0.2)
    return joined((points, organ.triangles), wall, object_id=ObjectId.TISSUE)


def _captured(rig: Rig, optics: StripeOptics, scene: SceneGeometry, rng: np.random.Generator) -> StripeCapture:
    camera = StripeCamera(rig, optics)
    camera.attach_geometry(scene)
    capture = camera.capture(None, np.eye(4), rng)
    camera.close()
    return capture


def _traced_image(rig: Rig, light: Light, scene: SceneGeometry, config: LightConfig, number: int) -> NDArray[np.uint8]:
    seen = with_vessels(scene) if light.vessels else scene
    camera = StripeCamera(rig, light.optics)
    camera.attach_geometry(seen)
    view = camera.exact(None, np.eye(4))
    camera.close()
    rows = (0, rig.camera.height)
    electrons = render_twin(rig, light.optics, seen, view, rows=rows, points=config.points, bounces=light.bounces)
    return digitised(electrons, light.optics, np.random.default_rng([config.seed, number, 1]))


def digitised(electrons: Array, optics: StripeOptics, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return grey values of expected photo-electrons, with shot and read noise and the camera's response."""
    deviation = np.sqrt(electrons + optics.read_noise_electrons**2)
    charge = electrons + deviation * rng.standard_normal(electrons.shape)
    signal = np.maximum(charge / optics.full_well_electrons * optics.response.gain, 0.0)
    grey: NDArray[np.uint8] = np.clip(np.round(255.0 * signal ** (1.0 / optics.response.gamma)), 0.0, 255.0).astype(np.uint8)
    return grey


def _errors(
    estimators: Mapping[str, DepthEstimator], image: NDArray[np.uint8], depth_mm: NDArray[np.float32], pixels: NDArray[np.bool_]
) -> dict[str, Array]:
    found = {name: estimator.estimate(image).depth_mm for name, estimator in estimators.items()}
    return {name: np.abs(estimate[pixels] - depth_mm[pixels]).astype(np.float64) for name, estimate in found.items()}


def _rows(errors: Mapping[tuple[str, str], Sequence[Array]]) -> list[dict[str, Any]]:
    means = {key: float(np.concatenate(list(parts)).mean()) for key, parts in errors.items()}
    return [
        {"model": model, "light": light, "mae_mm": mean, "ratio": mean / means[model, "stripe camera"]}
        for (model, light), mean in means.items()
    ]


def _within(depth_mm: NDArray[np.float32], span: tuple[float, float]) -> NDArray[np.bool_]:
    return np.asarray((depth_mm >= span[0]) & (depth_mm <= span[1]))
