"""The shape of the phantom: folded, gut-like lobes as a seeded height field, and the solid mesh below it.

Coils come from the Swift-Hohenberg equation, whose steady patterns are labyrinths of bands of nearly equal width that
meander, branch and end as packed loops of bowel do; a round cross-section over each band gives lobes with creases between
them. Pure numpy and scipy, free of any simulator.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from laploop.errors import InvalidValueError

Array = NDArray[np.float64]
Triangles = NDArray[np.int32]

_PATTERN_SIZE = 96
"""Samples along one side of the periodic square in which the pattern grows; larger than any phantom cut from it."""


@dataclass(frozen=True, kw_only=True)
class TissueShape:
    """What tissues of this family have in common; a seed makes one of them."""

    side_m: float = 0.120
    """Length and width of the phantom."""
    samples: int = 61
    """Vertices along one side of the top surface."""
    layers: int = 1
    """Solid cells from the bottom to the top."""
    height_m: float = 0.029
    """Height of the highest point above the bottom."""
    floor_m: float = 0.008
    """Least thickness, at the bottom of the deepest crease."""
    lobe_width_min_m: float = 0.026
    lobe_width_max_m: float = 0.034
    """Distance between neighbouring crests: that of an inflated small bowel, 25 to 35 mm across."""
    lobe_height_m: float = 0.0125
    """From crease to crest."""
    ridges: int = 5
    """Bands of tissue that bridge neighbouring lobes."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if not 9 <= self.samples <= _PATTERN_SIZE:
            raise InvalidValueError("samples", self.samples, f"an integer from 9 to {_PATTERN_SIZE}")
        if not 1 <= self.layers <= 8:
            raise InvalidValueError("layers", self.layers, "an integer from 1 to 8")
        if not 0.02 <= self.side_m <= 0.5:
            raise InvalidValueError("side_m", self.side_m, "0.02 to 0.5 m")
        if not 0.0 < self.floor_m < self.height_m <= 0.1:
            raise InvalidValueError("floor_m and height_m", (self.floor_m, self.height_m), "0 < floor < height <= 0.1 m")
        if not 0.0 < self.lobe_width_min_m <= self.lobe_width_max_m <= self.side_m:
            raise InvalidValueError(
                "lobe widths", (self.lobe_width_min_m, self.lobe_width_max_m), "0 < smallest <= largest <= side_m"
            )
        if not 0.0 <= self.lobe_height_m <= self.height_m - self.floor_m:
            raise InvalidValueError("lobe_height_m", self.lobe_height_m, "0 to height_m - floor_m")
        if self.ridges < 0:
            raise InvalidValueError("ridges", self.ridges, "an integer from 0")

    @property
    def spacing_m(self) -> float:
        """Distance between neighbouring columns of vertices."""
        return self.side_m / (self.samples - 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class TissueMesh:
    """A solid of tetrahedra and its visible surface, in the phantom's frame: origin below the middle, z up."""

    points: Array
    """(n, 3), metres, layer by layer from the bottom; within a layer, y runs fastest."""
    tetrahedra: NDArray[np.int32]
    """(m, 4), positively oriented."""
    surface_vertices: NDArray[np.int32]
    """(k,), indices into `points` of the vertices on the top and the sides; those of the top come first."""
    triangles: Triangles
    """(t, 3), indices into `surface_vertices`, anticlockwise when seen from outside; those of the top come first."""
    top_triangle_count: int


def height_field(shape: TissueShape, rng: np.random.Generator) -> Array:
    """Grow one tissue: heights (samples, samples) in metres above the bottom, indexed [x, y]."""
    wave = rng.uniform(shape.lobe_width_min_m, shape.lobe_width_max_m)
    pitch = shape.spacing_m
    lobes = _lobes(_labyrinth(rng, wave / pitch), wave / pitch)
    undulation = _band_noise(rng, 0.09 / pitch)
    # Haustra: shallow bulges along the coils.
    bulges = _band_noise(rng, 0.016 / pitch)
    corner = rng.integers(0, _PATTERN_SIZE - shape.samples + 1, size=2)
    window = tuple(slice(int(start), int(start) + shape.samples) for start in corner)
    lobes, undulation, bulges = lobes[window], undulation[window], bulges[window]
    lobes = _with_ridges(shape, lobes, rng)
    height = shape.lobe_height_m * lobes * (1.0 + 0.06 * undulation) + 0.0022 * undulation + 0.0009 * bulges
    # Rounds creases and the flanks of ridges to what tissue about 2 mm thick can do, and what the mesh can carry.
    height = ndimage.gaussian_filter(height, 0.0014 / pitch, mode="nearest")
    height *= min(1.0, (shape.height_m - shape.floor_m) / float(np.ptp(height)))
    height += shape.height_m - height.max()
    return np.asarray(height * _rounded_border(shape), dtype=np.float64)


def solid_mesh(shape: TissueShape, height: Array) -> TissueMesh:
    """Fill the space between the plane z = 0 and the height field with columns of tetrahedra.

    Raises:
        InvalidValueError: If the height field is not (samples, samples), finite and positive.
    """
    n, layers = shape.samples, shape.layers
    if height.shape != (n, n) or not np.all(np.isfinite(height)) or height.min() <= 0.0:
        raise InvalidValueError("height field", height.shape, f"({n}, {n}) of finite positive heights")
    line = np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, n)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.stack([np.stack([x, y, height * (k / layers)], axis=-1).reshape(-1, 3) for k in range(layers + 1)]).reshape(
        -1, 3
    )
    index = np.arange(points.shape[0], dtype=np.int32).reshape(layers + 1, n, n)
    sides = _side_quads(index)
    top = _split_quads(index[-1, :-1, :-1], index[-1, 1:, :-1], index[-1, 1:, 1:], index[-1, :-1, 1:])
    triangles = np.concatenate([top, sides])
    top_vertices = index[-1].ravel()
    others = np.setdiff1d(np.unique(sides), top_vertices)
    surface = np.concatenate([top_vertices, others]).astype(np.int32)
    place = np.full(points.shape[0], -1, dtype=np.int32)
    place[surface] = np.arange(surface.size, dtype=np.int32)
    return TissueMesh(
        points=points,
        tetrahedra=_tetrahedra(index),
        surface_vertices=surface,
        triangles=place[triangles],
        top_triangle_count=int(top.shape[0]),
    )


def _labyrinth(rng: np.random.Generator, wave: float) -> Array:
    """Evolve du/dt = eps u - (1 + laplacian)^2 u - u^3 from noise, semi-implicitly; `wave` is in samples."""
    n, eps, step = _PATTERN_SIZE, 0.3, 0.5
    k_squared = _wave_numbers_squared() * (wave / (2.0 * np.pi)) ** 2
    linear = 1.0 / (1.0 - step * (eps - (1.0 - k_squared) ** 2))
    field = _band_noise(rng, wave) * 0.4
    for _ in range(120):
        field = fft.irfft2(linear * fft.rfft2(field - step * field**3), s=(n, n))
    return np.asarray(field)


def _lobes(pattern: Array, wave: float) -> Array:
    """Turn the pattern into lobes of round cross-section, 0 in the creases and 1 on the crests."""
    envelope = np.sqrt(2.0 * ndimage.gaussian_filter(pattern**2, 0.5 * wave, mode="wrap"))
    # Where the pattern is a plane wave, this is the distance from the crest in half wavelengths.
    distance = np.arccos(np.clip(pattern / envelope, -1.0, 1.0)) / np.pi
    # An ellipse cut off at 0.8 of its half width, so that the flank keeps a finite slope in the crease.
    cut = 0.8
    lowest = np.sqrt(1.0 - cut**2)
    return np.asarray((np.sqrt(1.0 - (cut * distance) ** 2) - lowest) / (1.0 - lowest))


def _with_ridges(shape: TissueShape, lobes: Array, rng: np.random.Generator) -> Array:
    """Lay narrow bands across the creases, below the crests, blended by a smooth maximum."""
    line = np.linspace(-0.5 * shape.side_m, 0.5 * shape.side_m, shape.samples)
    x, y = np.meshgrid(line, line, indexing="ij")
    softness = 0.06
    result = lobes
    for _ in range(shape.ridges):
        centre = rng.uniform(-0.42 * shape.side_m, 0.42 * shape.side_m, size=2)
        angle, half_length = rng.uniform(0.0, np.pi), rng.uniform(0.010, 0.020)
        width, top, bend = rng.uniform(0.0025, 0.004), rng.uniform(0.55, 0.8), rng.uniform(-12.0, 12.0)
        along = (x - centre[0]) * np.cos(angle) + (y - centre[1]) * np.sin(angle)
        across = -(x - centre[0]) * np.sin(angle) + (y - centre[1]) * np.cos(angle) - bend * along**2
        overshoot = np.maximum(np.abs(along) - half_length, 0.0)
        band = top * np.exp(-0.5 * (across**2 + overshoot**2) / width**2)
        result = 0.5 * (result + band + np.sqrt((result - band) ** 2 + softness**2)) - 0.5 * softness
    return np.asarray(result)


def _rounded_border(shape: TissueShape) -> Array:
    """Return a factor (samples, samples) that lets the tissue fall off towards its four sides in a quarter of an ellipse."""
    line = np.linspace(0.0, shape.side_m, shape.samples)
    margin = 0.012
    inside = np.clip(np.minimum(line, shape.side_m - line) / margin, 0.0, 1.0)
    lowest = 0.45
    profile = lowest + (1.0 - lowest) * np.sqrt(1.0 - (1.0 - inside) ** 2)
    return np.asarray(np.minimum(profile[:, None], profile[None, :]))


def _band_noise(rng: np.random.Generator, wave: float) -> Array:
    """Return periodic noise of one wavelength (in samples) and unit standard deviation."""
    n = _PATTERN_SIZE
    k = np.sqrt(_wave_numbers_squared()) * (wave / (2.0 * np.pi))
    spectrum = fft.rfft2(rng.standard_normal((n, n))) * np.exp(-(((k - 1.0) / 0.25) ** 2))
    spectrum[0, 0] = 0.0
    noise = fft.irfft2(spectrum, s=(n, n))
    return np.asarray(noise / noise.std())


def _wave_numbers_squared() -> Array:
    """Return |k|^2 on the half spectrum of the pattern's square, in radians per sample."""
    kx = 2.0 * np.pi * fft.fftfreq(_PATTERN_SIZE)
    ky = 2.0 * np.pi * fft.rfftfreq(_PATTERN_SIZE)
    return np.asarray(kx[:, None] ** 2 + ky[None, :] ** 2)


def _split_quads(a: Triangles, b: Triangles, c: Triangles, d: Triangles) -> Triangles:
    """Split quads a-b-c-d (anticlockwise from outside) into triangles along a-c."""
    quads = np.stack([a.ravel(), b.ravel(), c.ravel(), d.ravel()], axis=-1)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _side_quads(index: NDArray[np.int32]) -> Triangles:
    """Return the triangles of the four sides of a grid of vertex indices [layer, x, y]."""
    walls = (index[:, :, 0], index[:, -1, :], index[:, ::-1, -1], index[:, 0, ::-1])
    return np.concatenate([_split_quads(wall[:-1, :-1], wall[:-1, 1:], wall[1:, 1:], wall[1:, :-1]) for wall in walls])


def _tetrahedra(index: NDArray[np.int32]) -> NDArray[np.int32]:
    """Cut every cell of the grid [layer, x, y] into six tetrahedra around its main diagonal (Kuhn's triangulation)."""
    steps = {"x": (0, 1, 0), "y": (0, 0, 1), "z": (1, 0, 0)}
    shape = tuple(size - 1 for size in index.shape)

    def corner(offset: tuple[int, int, int]) -> NDArray[np.int32]:
        return index[tuple(slice(o, o + s) for o, s in zip(offset, shape, strict=True))].ravel()

    result = []
    for order in ("xyz", "yzx", "zxy", "xzy", "yxz", "zyx"):
        path = [(0, 0, 0)]
        for axis in order:
            path.append(tuple(p + s for p, s in zip(path[-1], steps[axis], strict=True)))  # type: ignore[arg-type]
        columns = [corner(offset) for offset in path]
        if order in {"xzy", "yxz", "zyx"}:
            columns[2], columns[3] = columns[3], columns[2]
        result.append(np.stack(columns, axis=-1))
    return np.concatenate(result).astype(np.int32)
