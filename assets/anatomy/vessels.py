"""Vessels that grow over a surface and branch."""

import numpy as np
from scipy.spatial import cKDTree

from laploop.arrays import Array
from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh, vertex_normals

_STEP_M = 5e-4
_NARROWEST_M = 4e-4
_RIM_M = 5e-4
_OFF_SURFACE_M = 2e-3
"""A vessel ends where the surface does."""
_MOST_TIPS = 300


def branching_vessels(mesh: AnatomyMesh, rng: np.random.Generator) -> Array:
    """Return how far the vertices (n,) are under a vessel, 1, or beside, 0; vessels are up to 3 mm wide."""
    tree = cKDTree(mesh.points)
    middles, widths = _grow(mesh, tree, rng)
    distance, nearest = cKDTree(middles).query(mesh.points, distance_upper_bound=float(widths.max()))
    inside = np.zeros(len(mesh.points))
    near = np.flatnonzero(np.isfinite(distance))
    inside[near] = covered(0.5 * widths[nearest[near]] - distance[near])
    return inside


def covered(depth_m: Array) -> Array:
    """Return the coverage, 0 to 1, of vertices by their depth behind a rim, (n,).

    A rim is as sharp as the mesh can show it: sharper ones would follow its triangles.
    """
    return np.asarray(np.clip(depth_m / _RIM_M + 0.5, 0.0, 1.0))


def _grow(mesh: AnatomyMesh, tree: cKDTree, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return points (k, 3) along all vessels, and the widths there, (k,).

    All tips take a step at a time: along the surface, in a direction that wanders; now and then one divides.
    """
    normals = vertex_normals(mesh.points, mesh.triangles)
    roots = int(rng.integers(4, 22))
    tips = mesh.points[rng.integers(len(mesh.points), size=roots)]
    directions = rng.standard_normal((roots, 3))
    widths = np.exp(rng.uniform(np.log(6e-4), np.log(3e-3), size=roots))
    wander, branching = rng.uniform(0.08, 0.30), rng.uniform(0.01, 0.05)
    middles, found = [tips], [widths]
    for _ in range(int(rng.integers(60, 200))):
        nearest = tree.query(tips)[1]
        normal = normals[nearest]
        tips = tips - normal * np.einsum("ij,ij->i", tips - mesh.points[nearest], normal)[:, None]
        directions = directions + wander * rng.standard_normal(directions.shape)
        directions = directions - normal * np.einsum("ij,ij->i", directions, normal)[:, None]
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
        widths = 0.996 * widths
        divides = (rng.random(len(tips)) < branching) & (widths > 1.5 * _NARROWEST_M)
        if divides.any() and len(tips) < _MOST_TIPS:
            aside = np.cross(normal[divides], directions[divides]) * rng.choice([-1.0, 1.0], size=(int(divides.sum()), 1))
            turned = directions[divides] + rng.uniform(0.5, 1.5) * aside
            turned /= np.linalg.norm(turned, axis=1, keepdims=True)
            tips = np.concatenate([tips, tips[divides]])
            directions = np.concatenate([directions, turned])
            widths = np.concatenate([widths, 0.7 * widths[divides]])
        tips = tips + _STEP_M * directions
        alive = (widths > _NARROWEST_M) & (tree.query(tips)[0] < _OFF_SURFACE_M)
        if not alive.any():
            break
        tips, directions, widths = tips[alive], directions[alive], widths[alive]
        middles.append(tips)
        found.append(widths)
    return np.concatenate(middles), np.concatenate(found)
