"""Which line of the first frame becomes the path of a scan."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from laploop.arrays import Array
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import ExactView
from laploop.envs.tasks.configs import PathChoiceConfig
from laploop.envs.tasks.target_choice import qualifying_pixels, shaft_is_clear
from laploop.errors import SimulationError
from laploop.perception.geometry import Intrinsics

Mask = NDArray[np.bool_]

_STARTS = 400
"""Largest number of starts that are tried."""
_SHAFT_EVERY = 4
"""Clearance of the shaft is checked at every fourth point of the path."""
_LED_ON = 50
"""Where no walk is a path, so many of the longest are looked at: what each costs, a reset does."""
_BESIDE_M = 0.002
"""Half the width of the strip along a path whose steepest place is compared."""


def choose_path_pixels(
    view: ExactView,
    camera: Intrinsics,
    trocar_in_camera: Array,
    rng: np.random.Generator,
    config: PathChoiceConfig,
) -> Array:
    """Draw a path, evenly spaced pixels (points, 2), `length_m` long on the surface.

    A walk from a random start keeps to high ground, as one would draw a line along a loop of bowel, and turns by at most
    `max_turn_rad` a step. Of a few such lines the one is taken that keeps away farthest from steep flanks and from the edges
    of what is seen of the tissue. Where none is long enough, as among tight loops, the walks are led on from their starts the
    other way too, and the longest line is taken, if it has at least `min_share` of the length.

    Raises:
        SimulationError: If no path qualifies.
    """
    fits = qualifying_pixels(view, camera, trocar_in_camera, config.pixels)
    rows, columns = np.nonzero(fits)
    depth_m = view.depth_mm.astype(np.float64) * 1e-3
    surface = (camera.rays * depth_m[..., None])[np.isfinite(depth_m)][::4]
    steepness = _steepness(view, camera)
    found: list[Array] = []
    others: list[tuple[Array, float]] = []

    def clear(path: Array) -> list[bool]:
        points = camera.unproject(path, _values_at(depth_m, path))
        return [shaft_is_clear(point, trocar_in_camera, surface, config.pixels) for point in points]

    for start in rng.permutation(len(rows))[:_STARTS]:
        first = np.array([columns[start] + 0.5, rows[start] + 0.5])
        heading = float(rng.uniform(-np.pi, np.pi))
        walked, length_m = _walk(first, heading, depth_m, fits, camera, config)
        if length_m >= config.length_m:
            path = evenly(walked, depth_m, camera, config.points, config.length_m)
            if all(clear(path[::_SHAFT_EVERY])):
                found.append(path)
                if len(found) == config.candidates:
                    break
                continue
        others.append((walked, heading))
    if found:
        return min(found, key=lambda path: float(_values_at(steepness, path).max()))
    lines = [_led_back(walked, heading, depth_m, fits, camera, config) for walked, heading in others]
    longest = _longest(lines, clear, depth_m, camera)
    if longest is not None and path_length_m(longest, depth_m, camera)[-1] >= config.min_share * config.length_m:
        return evenly(longest, depth_m, camera, config.points, config.length_m)
    raise SimulationError(
        f"no line of {config.length_m * 1e3:.0f} mm in the first frame qualifies as a path, nor one of "
        f"{config.min_share * config.length_m * 1e3:.0f} mm ({len(rows)} pixels are lit tissue "
        f"within reach, {min(len(rows), _STARTS)} starts were tried); try another seed, a shorter path or a wider "
        "PathChoiceConfig"
    )


def _steepness(view: ExactView, camera: Intrinsics) -> Array:
    """Return the largest angle to the viewing ray around each pixel, (height, width) in radians; upright without tissue."""
    to_camera = -camera.rays / np.linalg.norm(camera.rays, axis=-1, keepdims=True)
    cosine = np.einsum("hwi,hwi->hw", view.normals.astype(np.float64), to_camera)
    tissue = view.object_id == ObjectId.TISSUE
    angle = np.where(tissue, np.arccos(np.clip(cosine, 0.0, 1.0)), np.pi / 2)
    if not tissue.any():
        return angle
    distance = 1e-3 * float(np.median(view.depth_mm[tissue]))
    return np.asarray(maximum_filter(angle, 2 * round(camera.fx * _BESIDE_M / distance) + 1))


def evenly(path: Array, depth_m: Array, camera: Intrinsics, points: int, length_m: float | None = None) -> Array:
    """Return a path of pixels (n, 2) by `points` others, (points, 2), evenly spaced on the surface.

    Args:
        path: Pixels (n, 2).
        depth_m: z-depth (height, width) in metres.
        camera: That saw it.
        points: How many to return.
        length_m: Where to end; the path's own end where it is not given.
    """
    along = path_length_m(path, depth_m, camera)
    places = np.linspace(0.0, along[-1] if length_m is None else min(length_m, along[-1]), points)
    return between(path, places, along)


def between(path: Array, places: Array, along: Array | None = None) -> Array:
    """Return a path of pixels (n, 2) at the given places along it, (k, 2); by default it is 1 from pixel to pixel."""
    given = np.arange(len(path), dtype=np.float64) if along is None else along
    return np.stack([np.interp(places, given, path[:, axis]) for axis in range(2)], axis=-1)


def path_length_m(path: Array, depth_m: Array, camera: Intrinsics) -> Array:
    """Return the length along a path of pixels (n, 2) from its first to each of its points, (n,), on the surface."""
    points = camera.unproject(path, _values_at(depth_m, path))
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _longest(lines: Sequence[Array], clear: Callable[[Array], list[bool]], depth_m: Array, camera: Intrinsics) -> Array | None:
    """Return the longest stretch of the longest lines (n, 2) over which the shaft is clear; None where it is nowhere."""
    best, best_m = None, 0.0
    for line in sorted(lines, key=lambda line: -path_length_m(line, depth_m, camera)[-1])[:_LED_ON]:
        along = path_length_m(line, depth_m, camera)
        if along[-1] <= best_m:
            break
        breaks = np.flatnonzero(~np.array([False, *clear(line), False])) - 1
        for low, high in pairwise(breaks):
            if high > low + 1 and along[high - 1] - along[low + 1] > best_m:
                best, best_m = line[low + 1 : high], along[high - 1] - along[low + 1]
    return best


def _led_back(walked: Array, heading: float, depth_m: Array, fits: Mask, camera: Intrinsics, config: PathChoiceConfig) -> Array:
    """Return a walk (n, 2) that began at a heading, led on from its start the other way, without a bend there."""
    if len(walked) > 1:
        heading = float(np.arctan2(*(walked[1] - walked[0])[::-1]))
    back, _ = _walk(walked[0], heading + np.pi, depth_m, fits, camera, config)
    return np.concatenate([back[:0:-1], walked])


def _walk(
    first: Array, heading: float, depth_m: Array, fits: Mask, camera: Intrinsics, config: PathChoiceConfig
) -> tuple[Array, float]:
    """Return the path from a pixel, (n, 2), and its length in metres: short of `length_m` where it leaves what qualifies."""
    path = [first]
    length = 0.0
    turns = np.linspace(-config.max_turn_rad, config.max_turn_rad, 7)
    while length < config.length_m:
        here = path[-1]
        depth = _values_at(depth_m, here)
        step_px = camera.fx * config.spacing_m / depth
        angles = heading + turns
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        ahead = here + step_px * np.array([1.0, 2.5, 4.0])[:, None, None] * directions
        inside = _at(fits, ahead[0])
        if not inside.any():
            break
        # The mean depth ahead tells how high the ground is; straight on wins a tie.
        cost = np.nanmean(np.where(_at(fits, ahead), _values_at(depth_m, ahead), depth + 0.01), axis=0) + 1e-4 * np.abs(turns)
        best = int(np.argmin(np.where(inside, cost, np.inf)))
        heading = float(angles[best])
        path.append(ahead[0, best])
        pair = np.stack(path[-2:])
        way = np.diff(camera.unproject(pair, _values_at(depth_m, pair)), axis=0)
        length += float(np.linalg.norm(way))
    return np.array(path), length


def _at(mask: Mask, pixels: Array) -> Mask:
    height, width = mask.shape
    columns, rows = np.moveaxis(np.floor(pixels).astype(int), -1, 0)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    return np.asarray(inside & mask[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)])


def _values_at(image: Array, pixels: Array) -> Array:
    height, width = image.shape
    columns, rows = np.moveaxis(np.floor(pixels).astype(int), -1, 0)
    return np.asarray(image[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)])
