"""Textures of anatomy by name: factors on the albedo at the vertices of a mesh, and which of them no network may learn from.

Bright and dark places are those of green light, which blood absorbs: vessels, blood and inflamed spots are dark, fat is bright.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.vessels import branching_vessels, covered
from laploop.assets.tissue_appearance import gaussian_field
from laploop.errors import UnknownNameError

OWN_TEXTURE = "own"
"""That of the height fields, `tissue_albedo`, of the family `tissue`."""

DARKEST, BRIGHTEST = 0.02, 2.0
_MOTTLE_WAVELENGTHS_M = (0.003, 0.040)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceTexture:
    """What a surface looks like."""

    albedo_factor: Array
    """(n,), multiplies the albedo of the material at each vertex; from `DARKEST` to `BRIGHTEST`."""
    wet: NDArray[np.bool_]
    """(n,), vertices under a film of liquid, which is smoother than the tissue."""


@dataclass(frozen=True, kw_only=True)
class Texture:
    """One kind of texture."""

    paint: Callable[[AnatomyMesh, np.random.Generator], SurfaceTexture]
    held_out: bool = False
    """Kept for evaluation: no network learns from it, and no weights are chosen by it."""
    weight: float = 1.0
    """How often it is drawn among those of its kind, relative to the others."""


def _plain(mesh: AnatomyMesh, _rng: np.random.Generator) -> SurfaceTexture:
    """Return the same albedo everywhere: nothing but stripes and shading shows the shape."""
    return _dry(np.ones(len(mesh.points)))


def _mottled(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return a smooth random variation, 5 to 25 % in the standard deviation."""
    return _dry(_mottle(mesh, rng, rng.uniform(0.05, 0.25)))


def _vessels(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return branching vessels with sharp rims, 0.4 to 3 mm wide."""
    inside = branching_vessels(mesh, rng)
    return _dry(_mottle(mesh, rng, rng.uniform(0.0, 0.1)) * (1.0 - rng.uniform(0.35, 0.8) * inside))


def _fat(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return islands of fat, 1.3 to 1.9 times as bright, on a twentieth to half of the surface."""
    inside = _patches(mesh, rng, coverage=rng.uniform(0.05, 0.5), size_m=rng.uniform(0.004, 0.020), border=0.15)
    return _dry(_mottle(mesh, rng, rng.uniform(0.0, 0.08)) * (1.0 + rng.uniform(0.3, 0.9) * inside))


def _blood(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return pools of blood that take 55 to 92 % of the light, their borders smooth, their surface wet."""
    inside = _patches(mesh, rng, coverage=rng.uniform(0.04, 0.3), size_m=rng.uniform(0.006, 0.025), border=0.5)
    factor = _mottle(mesh, rng, rng.uniform(0.0, 0.12)) * (1.0 - rng.uniform(0.55, 0.92) * inside)
    return SurfaceTexture(albedo_factor=np.clip(factor, DARKEST, BRIGHTEST), wet=inside > 0.5)


def _lattice(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return a network of capillaries, 0.5 to 1.2 mm wide, around cells 3 to 9 mm across: the borders of Voronoi cells."""
    cell, width = rng.uniform(0.003, 0.009), rng.uniform(0.0005, 0.0012)
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    # Seeds in space, evenly enough by a jittered grid; only those near the surface make cells.
    counts = np.maximum(1, np.ceil((high - low) / cell)).astype(int)
    grid = np.stack(np.meshgrid(*(np.arange(count) for count in counts), indexing="ij"), axis=-1).reshape(-1, 3)
    seeds = low + cell * (grid + rng.uniform(0.0, 1.0, size=grid.shape))
    nearest = cKDTree(seeds).query(mesh.points, k=2)[0]
    # Half the difference is the distance from the border where both seeds are level with it.
    inside = covered(0.5 * (width - (nearest[:, 1] - nearest[:, 0])))
    return _dry(_mottle(mesh, rng, rng.uniform(0.0, 0.08)) * (1.0 - rng.uniform(0.3, 0.7) * inside))


def _lesions(mesh: AnatomyMesh, rng: np.random.Generator) -> SurfaceTexture:
    """Return 10 to 80 spots, 2 to 14 mm across, dark or bright, with sharp rims."""
    factor = _mottle(mesh, rng, rng.uniform(0.0, 0.1))
    tree, wobble = cKDTree(mesh.points), gaussian_field(mesh.points, (0.003, 0.008), rng)
    for centre in mesh.points[rng.integers(len(mesh.points), size=rng.integers(10, 81))]:
        radius = rng.uniform(0.001, 0.007)
        near = np.array(tree.query_ball_point(centre, 2.0 * radius), dtype=np.intp)
        distance = np.linalg.norm(mesh.points[near] - centre, axis=1) * (1.0 + 0.12 * np.clip(wobble[near], -3.0, 3.0))
        change = rng.uniform(0.15, 0.7) if rng.random() < 0.65 else rng.uniform(1.3, 1.8)
        factor[near] *= 1.0 + (change - 1.0) * covered(radius - distance)
    return _dry(factor)


TEXTURES: Mapping[str, Texture] = MappingProxyType(
    {
        "plain": Texture(paint=_plain),
        "mottled": Texture(paint=_mottled),
        "vessels": Texture(paint=_vessels, weight=1.5),
        "fat": Texture(paint=_fat),
        "blood": Texture(paint=_blood),
        "lattice": Texture(paint=_lattice, held_out=True),
        "lesions": Texture(paint=_lesions, held_out=True),
    }
)


def texture_named(name: str) -> Texture:
    """Return a texture.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name not in TEXTURES:
        raise UnknownNameError("texture of anatomy", name, TEXTURES)
    return TEXTURES[name]


def texture_names(*, held_out: bool) -> tuple[str, ...]:
    """Return the names of the textures that are held out, or of those that networks may learn from."""
    return tuple(name for name, texture in TEXTURES.items() if texture.held_out == held_out)


def _dry(factor: Array) -> SurfaceTexture:
    return SurfaceTexture(albedo_factor=np.clip(factor, DARKEST, BRIGHTEST), wet=np.zeros(len(factor), dtype=np.bool_))


def _mottle(mesh: AnatomyMesh, rng: np.random.Generator, deviation: float) -> Array:
    return np.asarray(1.0 + deviation * gaussian_field(mesh.points, _MOTTLE_WAVELENGTHS_M, rng))


def _patches(mesh: AnatomyMesh, rng: np.random.Generator, *, coverage: float, size_m: float, border: float) -> Array:
    """Return 1 inside patches on a fraction of the vertices, 0 outside; `border` is in deviations of the field behind them."""
    field = gaussian_field(mesh.points, (size_m, 2.5 * size_m), rng)
    inside = np.clip((field - np.quantile(field, 1.0 - coverage)) / border + 0.5, 0.0, 1.0)
    return np.asarray(inside * inside * (3.0 - 2.0 * inside))
