"""Compares the stripe camera's images with the path tracer's: contrast, stripe edges, penumbra, spots, light."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from laploop.arrays import Array
from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.geometry import Rig
from laploop.studies.characterization.run import find_extrema, michelson_contrast
from laploop.studies.twin.render import check_mitsuba, render_twin
from laploop.studies.twin.scene import (
    PLANE_DISTANCES_MM,
    SPOT_DISTANCE_M,
    SPOT_SPACING_PX,
    SPOTS,
    TwinScene,
    fold_scene,
    organ_scene,
    plane_scene,
    shadow_scene,
    sphere_scene,
    spot_scene,
    vessel_scene,
)

_SAME_EDGE_PX = 1.5
"""Edges of the two images that are farther apart are not the same edge."""
_CLEAR = 0.02
"""Edges count where the stripes swing by this fraction of the brightest value a pixel."""
_WALL = slice(60, 128)
"""Columns that see the wall left of the screen."""
_MIDDLE = slice(78, 178)
"""Columns over which the contrast of a plane is measured."""
SPOT_LEVELS = (0.5, 0.1)
"""Of its peak, where the width of a line's light is measured."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneComparison:
    """Expected photo-electrons of one scene, by the stripe camera and by the path tracer."""

    scene: TwinScene
    camera: Array
    twin: Array

    @property
    def brightness(self) -> float:
        """Mean of the stripe camera's image over that of the path tracer's."""
        return float(self.camera.mean() / self.twin.mean())

    def edge_offsets_px(self, period_px: float) -> Array:
        """Return how far the stripes' edges are apart along the rows, for all edges that both images show."""
        offsets: list[float] = []
        least = _CLEAR * float(self.twin.max())
        for ours, theirs in zip(self.camera, self.twin, strict=True):
            found, wanted = (_crossings(row, period_px, least) for row in (ours, theirs))
            for rising in (True, False):
                places = np.array([x for x, up in found if up == rising])
                for x, up in wanted:
                    if up == rising and len(places):
                        nearest = places[np.abs(places - x).argmin()] - x
                        if abs(nearest) < _SAME_EDGE_PX:
                            offsets.append(float(nearest))
        return np.array(offsets)


@dataclass(frozen=True, kw_only=True, eq=False)
class TwinComparison:
    """All scenes, and what was measured on them."""

    planes: tuple[SceneComparison, ...]
    scenes: tuple[SceneComparison, ...]
    """Sphere, folds, vessels, organ with an instrument."""
    shadow: SceneComparison
    spots: tuple[SceneComparison, ...]
    """Lines of light, on what `SPOTS` lists."""
    period_px: float
    """Of the stripes in the image."""

    @property
    def contrasts(self) -> Array:
        """Michelson contrast of the planes, (planes, 2): of the stripe camera and of the path tracer."""
        return np.array([[_plane_contrast(image, self.period_px) for image in (p.camera, p.twin)] for p in self.planes])

    @property
    def penumbra_px(self) -> tuple[float, float]:
        """Width of the shadow's border from a tenth to nine tenths of the light, of the stripe camera and the path tracer."""
        ours, theirs = (_fall_px(image.mean(axis=0)) for image in (self.shadow.camera, self.shadow.twin))
        return ours, theirs

    @property
    def spot_widths_mm(self) -> Array:
        """Width of a line's light on the surface, (spots, levels, 2): of the stripe camera and of the path tracer."""
        profiles = [[line_profile(image) for image in (spot.camera, spot.twin)] for spot in self.spots]
        return np.array([[[width_at(*line, level) for line in pair] for level in SPOT_LEVELS] for pair in profiles])

    def as_dict(self) -> dict[str, Any]:
        """Return what was measured, as plain data."""
        contrasts = zip(PLANE_DISTANCES_MM, self.contrasts.tolist(), strict=True)
        return {
            "contrast": [{"distance_mm": mm, "stripe_camera": ours, "path_tracer": theirs} for mm, (ours, theirs) in contrasts],
            "scenes": [self._scene_row(compared) for compared in self.scenes],
            "penumbra_px": _by_renderer(self.penumbra_px),
            "spot": [
                {"profile": spread.profile, "half_mm": _by_renderer(half), "tenth_mm": _by_renderer(tenth)}
                for spread, (half, tenth) in zip(SPOTS, self.spot_widths_mm.tolist(), strict=True)
            ],
        }

    def _scene_row(self, compared: SceneComparison) -> dict[str, Any]:
        offsets = np.abs(compared.edge_offsets_px(self.period_px))
        return {
            "scene": compared.scene.name,
            "brightness": compared.brightness,
            "edges": len(offsets),
            "edge_median_px": float(np.median(offsets)),
            "edge_p95_px": float(np.percentile(offsets, 95)),
        }


def compare_with_twin(progress: Callable[[float], None] | None = None) -> TwinComparison:
    """Render all scenes twice; `progress` is called with the fraction done.

    Raises:
        InvalidValueError: If Mitsuba is not installed.
    """
    check_mitsuba()
    scenes = [plane_scene(distance) for distance in PLANE_DISTANCES_MM]
    scenes += [sphere_scene(), fold_scene(), vessel_scene(), organ_scene(), shadow_scene()]
    scenes += [spot_scene(spread) for spread in SPOTS]
    done = []
    for number, scene in enumerate(scenes, start=1):
        done.append(compare_scene(scene))
        if progress is not None:
            progress(number / len(scenes))
    planes, spots = len(PLANE_DISTANCES_MM), len(SPOTS)
    rig = Rig.from_optics(ScopeOptics())
    return TwinComparison(
        planes=tuple(done[:planes]),
        scenes=tuple(done[planes : -spots - 1]),
        shadow=done[-spots - 1],
        spots=tuple(done[-spots:]),
        period_px=rig.mask.period_tan * rig.camera.fx,
    )


def compare_scene(scene: TwinScene) -> SceneComparison:
    """Render a scene with the stripe camera and with the path tracer."""
    rig = replace(Rig.from_optics(ScopeOptics()), mask=scene.mask)
    camera = StripeCamera(rig, scene.optics)
    camera.attach_geometry(scene.geometry)
    capture = camera.capture(None, np.eye(4), None)
    camera.close()
    twin = render_twin(rig, scene.optics, scene.geometry, capture, rows=scene.rows)
    return SceneComparison(scene=scene, camera=capture.electrons[slice(*scene.rows)].astype(np.float64), twin=twin)


def line_profile(image: Array) -> tuple[Array, Array]:
    """Return places across a line in mm on the surface and its light there, from the rows of a `spot_scene`.

    The middle third of the rows counts, which light can reach from all that scatter.
    """
    third = len(image) // 3
    place_px, light = fold_lines(image[third:-third].mean(axis=0), SPOT_SPACING_PX)
    return place_px * 1e3 * SPOT_DISTANCE_M / Rig.from_optics(ScopeOptics()).camera.fx, light


def fold_lines(profile: Array, spacing_px: float) -> tuple[Array, Array]:
    """Lay equal lines of light, which cross a row, on top of each other.

    Args:
        profile: The row's light, (width,).
        spacing_px: From line to line.

    Returns:
        Places in pixels from the lines' common middle, ascending, and the light there as a share of its line's.
    """
    x = np.arange(len(profile)) + 0.5
    turns = x / spacing_px - np.angle(np.sum(profile * np.exp(2j * np.pi * x / spacing_px))) / (2.0 * np.pi)
    line = np.round(turns).astype(int)
    sums = np.bincount(line - line.min(), weights=profile)[line - line.min()]
    place = spacing_px * (turns - line)
    order = [i for i in np.argsort(place) if sums[i] > 0.5 * sums.max()]
    return place[order], profile[order] / sums[order]


def width_at(place: Array, light: Array, level: float) -> float:
    """Return how wide a line's light is where it falls to a fraction of its peak, on both sides, in the unit of `place`."""
    least = level * light.max()
    first, *_, last = np.flatnonzero(light >= least)
    left = np.interp(least, light[[first - 1, first]], place[[first - 1, first]])
    right = np.interp(least, light[[last + 1, last]], place[[last + 1, last]])
    return float(right - left)


def _by_renderer(pair: Iterable[float]) -> dict[str, float]:
    return dict(zip(("stripe_camera", "path_tracer"), pair, strict=True))


def _plane_contrast(image: Array, period_px: float) -> float:
    profile = image[4:-4, _MIDDLE].mean(axis=0)
    return michelson_contrast(profile, *find_extrema(profile, 0.6 * period_px))


def _crossings(row: Array, period_px: float, least: float) -> list[tuple[float, bool]]:
    """Return where a row crosses its mean over a period, pixel centres at +0.5, and whether it rises there."""
    swing = row - uniform_filter1d(row, round(period_px))
    before, after = swing[:-1], swing[1:]
    found = np.flatnonzero((before * after < 0.0) & (np.abs(after - before) > least))
    return [(float(i + 0.5 + before[i] / (before[i] - after[i])), bool(after[i] > before[i])) for i in found]


def _fall_px(profile: Array) -> float:
    """Return how far it is from nine tenths to one tenth of the light, towards the darkest place and left of it."""
    dark = _WALL.start + int(np.argmin(profile[_WALL]))
    left = profile[dark - 20 : dark + 1] / profile[dark - 20]
    below = [float(np.flatnonzero(left < level)[0]) for level in (0.9, 0.1)]
    ends = [
        i - 1.0 + (left[int(i) - 1] - level) / (left[int(i) - 1] - left[int(i)])
        for i, level in zip(below, (0.9, 0.1), strict=True)
    ]
    return float(ends[1] - ends[0])
