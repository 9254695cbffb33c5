"""Scenes for the comparison of the stripe camera with a path tracer: planes, sphere, folds, vessels, organ, shadow, lines."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from laploop.arrays import Array
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.stripe_optics import Material, StripeOptics
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.envs.sensors.tracing import primitives
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry

PLANE_DISTANCES_MM = (60, 80, 100, 120, 140)
SPOT_DISTANCE_M = 0.070
SPOT_SPACING_PX = 35.2
"""From line to line: they fall on five places of a pixel, so that all of them together are one of five times as many pixels."""
SPOTS = (
    Subsurface(),
    Subsurface(profile="gaussian", fwhm_m=0.001),
    Subsurface(profile="dipole", reduced_scattering_per_m=1000.0, absorption_per_m=150.0),
)
"""A card, and tissue of two kinds."""
_SPOT_STEPS = 160
"""Of the mask, as wide as the lines: 0.5 mm on the surface, 1.6 px."""
_STEP_M = 1e-3
_HALF_M = 0.075
_MATTE = Material(albedo=0.4, reflectance=0.0, roughness=1.0)


def twin_optics() -> StripeOptics:
    """Return the nominal optics without what the path tracer's side leaves out: gloss and the light of the cavity."""
    spread = Subsurface(profile="gaussian", fwhm_m=0.001)
    tissue = Material(albedo=0.4, reflectance=0.0, roughness=1.0, subsurface=spread)
    return StripeOptics(cavity_fraction=0.0, tissue=tissue, tool=_MATTE, stage=_MATTE, other=_MATTE)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinScene:
    """A scene before a camera at the world's origin, and what of it is compared."""

    name: str
    geometry: SceneGeometry
    mask: StripeMask
    optics: StripeOptics = field(default_factory=twin_optics)
    rows: tuple[int, int] = (0, 256)
    """First row and the row behind the last."""


def plane_scene(distance_mm: int) -> TwinScene:
    """Return a facing matte plane, of which a few rows are enough."""
    z = 1e-3 * distance_mm
    geometry = height_field(lambda x, _: np.full_like(x, z), half_m=2.0, step_m=2.0)
    return TwinScene(name=f"plane at {distance_mm} mm", geometry=geometry, mask=StripeMask(), rows=(120, 136))


def sphere_scene() -> TwinScene:
    """Return a sphere of 60 mm before a wall."""
    points, triangles = primitives.sphere(0.03)
    wall = height_field(lambda x, _: np.full_like(x, 0.13), half_m=0.15, step_m=0.15)
    return TwinScene(name="sphere", geometry=joined((points + [0.0, 0.0, 0.1], triangles), wall), mask=StripeMask())


def fold_scene() -> TwinScene:
    """Return lobes that meet in sharp folds, aslant to the stripes."""

    def height(x: Array, y: Array) -> Array:
        return 0.095 - 0.014 * np.abs(np.sin(math.pi * (x + 0.35 * y) / 0.03))

    return TwinScene(name="folds", geometry=height_field(height), mask=StripeMask())


def vessel_scene() -> TwinScene:
    """Return an inclined plane with dark vessels of 1 to 2 mm."""
    geometry = height_field(lambda x, y: 0.085 + 0.15 * x + 0.25 * y, step_m=5e-4)
    return TwinScene(name="vessels", geometry=with_vessels(geometry), mask=StripeMask())


def with_vessels(geometry: SceneGeometry) -> SceneGeometry:
    """Return a scene with dark vessels of 1 to 2 mm along y, as sharp as the mesh is fine."""
    x, y = geometry.points[:, 0], geometry.points[:, 1]
    path = np.abs(np.sin(math.pi * (x + 0.004 * np.sin(200.0 * y)) / 0.016)) * 0.016 / math.pi
    return SceneGeometry(
        points=geometry.points,
        triangles=geometry.triangles,
        object_ids=geometry.object_ids,
        albedo_factor=np.where(path < 0.001, 0.45, 1.0),
    )


def organ_scene() -> TwinScene:
    """Return scattering lobes with an instrument of 8 mm across them, which casts a soft shadow."""

    def height(x: Array, y: Array) -> Array:
        return 0.092 + 0.005 * np.sin(180.0 * x) * np.cos(220.0 * y) + 0.003 * np.sin(310.0 * y + 90.0 * x)

    organ = height_field(height, object_id=ObjectId.TISSUE)
    points, triangles = primitives.capsule(0.004, 0.05)
    along = np.array([math.cos(0.35), math.sin(0.35), 0.0])
    aside = np.array([-along[1], along[0], 0.0])
    rotation = np.column_stack([aside, [0.0, 0.0, 1.0], along])
    rod = (points @ rotation.T + [0.055, 0.008, 0.066], triangles)
    return TwinScene(name="organ and instrument", geometry=joined(rod, organ, object_id=ObjectId.TOOL), mask=StripeMask())


def shadow_scene() -> TwinScene:
    """Return a screen over half of a wall, under a clear mask."""
    wall = height_field(lambda x, _: np.full_like(x, 0.1), half_m=0.15, step_m=0.15)
    screen = np.array([[-0.004, -0.1, 0.05], [0.1, -0.1, 0.05], [0.1, 0.1, 0.05], [-0.004, 0.1, 0.05]])
    geometry = joined((screen, np.array([[0, 1, 2], [0, 2, 3]])), wall)
    return TwinScene(name="shadow", geometry=geometry, mask=StripeMask(profile=(1.0,)), rows=(112, 144))


def spot_scene(subsurface: Subsurface) -> TwinScene:
    """Return a facing plane of a material under five fine lines of light, from a projector that is in focus there.

    The rows are as many as a dipole's light crosses on its way to the middle ones.
    """
    spacing = round(SPOT_SPACING_PX * _SPOT_STEPS / 256)
    profile = np.zeros(_SPOT_STEPS)
    profile[_SPOT_STEPS // 2 + spacing * np.arange(-2, 3)] = 1.0
    optics = twin_optics()
    sharp = replace(
        optics,
        source_blur_tan=0.002,
        projector_focus_m=SPOT_DISTANCE_M,
        glare_fraction=0.0,
        tissue=replace(optics.tissue, subsurface=subsurface),
    )
    plane = height_field(lambda x, _: np.full_like(x, SPOT_DISTANCE_M), object_id=ObjectId.TISSUE, half_m=2.0, step_m=2.0)
    mask = StripeMask(profile=tuple(profile.tolist()))
    return TwinScene(name=f"lines, {subsurface.profile}", geometry=plane, mask=mask, optics=sharp, rows=(80, 176))


def height_field(
    height: Callable[[Array, Array], Array],
    *,
    object_id: int = ObjectId.OTHER,
    half_m: float = _HALF_M,
    step_m: float = _STEP_M,
) -> SceneGeometry:
    """Tessellate the surface z = height(x, y), metres, over a square around the camera's axis."""
    count = round(2.0 * half_m / step_m) + 1
    axis = np.linspace(-half_m, half_m, count)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    first = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([first, first + 1, first + count + 1], axis=1), np.stack([first, first + count + 1, first + count], axis=1)]
    )
    points = np.stack([x, y, height(x, y)], axis=1)
    return SceneGeometry(points=points, triangles=triangles, object_ids=object_id)


def joined(front: primitives.Surface, back: SceneGeometry, *, object_id: int = ObjectId.OTHER) -> SceneGeometry:
    """Put a surface before a scene."""
    points, triangles = front
    return SceneGeometry(
        points=np.concatenate([points, back.points]),
        triangles=np.concatenate([triangles, back.triangles + len(points)]),
        object_ids=np.concatenate([np.full(len(triangles), object_id), back.object_ids]),
        albedo_factor=np.concatenate([np.ones(len(points)), back.albedo_factor]),
    )
