"""Anatomy, a wall behind it and instruments before it, as plain triangles: what the endoscope sees, without physics."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh, joined
from laploop.assets.anatomy.families.registry import family_named
from laploop.assets.anatomy.families.walls import back_wall
from laploop.assets.anatomy.textures import texture_named
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.tracing import primitives
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.studies.scenes.anatomy_optics import AnatomyMaterials

Array = NDArray[np.float64]

MOST_TOOLS = 2

_SHAFT_DIAMETERS_M = (0.005, 0.008)
_SHAFT_LENGTH_M = 0.300
_NECK_M = 0.008
_AWAY_M = np.array([2.0, 0.0, 1.0])
_GAP_M = (0.010, 0.070)
"""From the organ's upper face to the middle of the wall behind it."""
_BELOW_M = (0.0, 0.030)
"""From the organ's lowest point, where the wall must lie below it."""
_UNSEEN = -0.97
"""Upward part of the normal of triangles that no camera sees: the flat undersides of organs on the table."""
_PART_FACTORS = (0.5, 1.6)
"""Albedo of further organs and of the wall over the first organ's: fat beside serosa, for example."""
_CELL_M = 2e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolPlacement:
    """Where an instrument is."""

    tip: Array
    """(3,), centre of the ball end."""
    axis: Array
    """(3,), unit vector along the shaft to the tip."""


class AnatomyScene:
    """An organ of some family and texture, and instruments that can be placed anywhere; nothing gives way.

    World: z up, metres, origin in the middle of the organ as its builder has it.

    Attributes:
        geometry: What a camera is attached to.
        tops: (k, 3), points of the organ that can be seen from above.
        tip_radii_m: Of the instruments' ball ends.
    """

    def __init__(self, family: str, texture: str, materials: AnatomyMaterials, rng: np.random.Generator) -> None:
        """Grow a scene.

        Raises:
            UnknownNameError: If there is no such family or texture.
            InvalidValueError: If scikit-image (extra `mesh`) is not installed.
        """
        kind, look = family_named(family), texture_named(texture)
        organ = kind.build(rng)
        self.tops = _tops(organ.points)
        meshes = [organ]
        if rng.random() < kind.wall_fraction:
            lowest, face = float(organ.points[:, 2].min()), float(np.median(self.tops[:, 2]))
            level = lowest - rng.uniform(*_BELOW_M) if kind.wall_below else face - rng.uniform(*_GAP_M)
            meshes.append(_lifted(back_wall(rng), level))
        mesh = _seen(joined(meshes))
        surface = look.paint(mesh, rng)
        factors = np.concatenate([[1.0], rng.uniform(*_PART_FACTORS, size=int(mesh.parts.max()))])
        part = np.zeros(len(mesh.points), dtype=np.int32)
        part[mesh.triangles.ravel()] = np.repeat(mesh.parts, 3)
        albedo = np.minimum(surface.albedo_factor * factors[part], materials.largest_factor)
        wet = surface.wet[mesh.triangles].all(axis=1)
        diameters = rng.choice(_SHAFT_DIAMETERS_M, size=MOST_TOOLS)
        self.tip_radii_m = rng.uniform(0.3, 0.55, size=MOST_TOOLS) * diameters
        tools = [_tool(0.5 * shaft, tip) for shaft, tip in zip(diameters, self.tip_radii_m, strict=True)]
        points, triangles = primitives.join([(mesh.points, mesh.triangles), *tools])
        counts = [len(tool_triangles) for _, tool_triangles in tools]
        ids = np.where(wet, int(ObjectId.OTHER), int(ObjectId.TISSUE))
        self.geometry = SceneGeometry(
            points=points,
            triangles=triangles,
            object_ids=np.concatenate([ids, np.full(sum(counts), int(ObjectId.TOOL))]),
            albedo_factor=np.concatenate([albedo, np.ones(len(points) - len(albedo))]),
            parts=np.concatenate([mesh.parts, int(mesh.parts.max()) + 1 + np.repeat(np.arange(MOST_TOOLS), counts)]),
        )
        self._tools = [tool_points for tool_points, _ in tools]
        self.place_tools([])

    def place_tools(self, placements: Sequence[ToolPlacement]) -> None:
        """Put the first instruments where they are wanted, and the others out of sight."""
        points = self.geometry.points.copy()
        first = len(points) - sum(len(tool) for tool in self._tools)
        for number, tool in enumerate(self._tools):
            rows = slice(first, first + len(tool))
            first = rows.stop
            if number < len(placements):
                placed = placements[number]
                points[rows] = tool @ _frame(placed.axis).T + placed.tip
            else:
                points[rows] = tool + _AWAY_M
        self.geometry.move(points)


def _tops(points: Array) -> Array:
    """Return the highest of the points (n, 3) over each square of a grid."""
    order = np.argsort(-points[:, 2], kind="stable")
    cells = np.floor(points[order, :2] / _CELL_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return points[order[first]]


def _lifted(mesh: AnatomyMesh, level: float) -> AnatomyMesh:
    return AnatomyMesh(points=mesh.points + [0.0, 0.0, level], triangles=mesh.triangles, parts=mesh.parts)


def _seen(mesh: AnatomyMesh) -> AnatomyMesh:
    """Return a mesh without the triangles that face away from every camera."""
    corners = mesh.points[mesh.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    kept = area[:, 2] > _UNSEEN * np.linalg.norm(area, axis=1)
    return AnatomyMesh(points=mesh.points, triangles=mesh.triangles[kept], parts=mesh.parts[kept])


def _tool(radius: float, tip_radius: float) -> primitives.Surface:
    """Return a shaft along z that ends in a ball around the origin; a neck joins them."""
    ball = primitives.sphere(tip_radius)
    neck_points, neck_triangles = primitives.cylinder(0.6 * min(radius, tip_radius), 0.5 * _NECK_M)
    shaft_points, shaft_triangles = primitives.cylinder(radius, 0.5 * _SHAFT_LENGTH_M)
    neck = (neck_points - [0.0, 0.0, 0.5 * _NECK_M], neck_triangles)
    shaft = (shaft_points - [0.0, 0.0, 0.5 * _SHAFT_LENGTH_M + 0.8 * _NECK_M], shaft_triangles)
    return primitives.join([ball, neck, shaft])


def _frame(axis: Array) -> Array:
    """Return a rotation whose z axis is a unit vector."""
    least = np.eye(3)[int(np.argmin(np.abs(axis)))]
    y = np.cross(axis, least)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, axis), y, axis])
