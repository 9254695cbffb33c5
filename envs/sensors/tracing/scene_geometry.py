"""The surfaces that rays can hit: those of a MuJoCo model, or plain triangles."""

import functools
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from laploop.assets.tissue_appearance import TissueAppearance, tissue_albedo
from laploop.envs.sensors.object_id import ObjectId, object_id_of_geom
from laploop.envs.sensors.tracing import primitives
from laploop.envs.sensors.tracing.tissue_surface import FlexSurface, TissueSurface
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True, eq=False)
class _RigidPart:
    geom: int
    rows: slice
    points_in_geom: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class _TissuePart:
    surface: TissueSurface | FlexSurface
    rows: slice


_PRIMITIVES: dict[mujoco.mjtGeom, tuple[Callable[..., primitives.Surface], int]] = {
    mujoco.mjtGeom.mjGEOM_SPHERE: (primitives.sphere, 1),
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: (primitives.ellipsoid, 3),
    mujoco.mjtGeom.mjGEOM_CAPSULE: (primitives.capsule, 2),
    mujoco.mjtGeom.mjGEOM_CYLINDER: (primitives.cylinder, 2),
    mujoco.mjtGeom.mjGEOM_BOX: (primitives.box, 3),
    mujoco.mjtGeom.mjGEOM_PLANE: (primitives.plane, 2),
}
"""The function that makes a geom's triangles, and the number of the geom's sizes that it takes."""


class SceneGeometry:
    """Triangles with an object class and vertices with an albedo; points move, everything else is fixed.

    Attributes:
        points: (n, 3) float32, world frame, metres.
        triangles: (m, 3) int32, rows of `points`; vertices are shared where the surface should look smooth.
        object_ids: (m,) uint8, an `ObjectId` a triangle.
        albedo_factor: (n,) float32, multiplies the albedo of the object's material at each vertex.
        parts: (m,) int32, the connected object that a triangle belongs to.
    """

    def __init__(
        self,
        *,
        points: NDArray[np.floating],
        triangles: NDArray[np.integer],
        object_ids: NDArray[np.integer] | int,
        albedo_factor: NDArray[np.floating] | float = 1.0,
        parts: NDArray[np.integer] | int = 0,
    ) -> None:
        """Make a scene of plain arrays; a single object id, factor or part applies to all.

        Raises:
            InvalidValueError: If shapes, indices, object ids or numbers do not make a scene.
        """
        self.points = np.array(points, dtype=np.float32)
        self.triangles = np.array(triangles, dtype=np.int32)
        if self.points.ndim != 2 or self.points.shape[1] != 3 or len(self.points) == 0:
            raise InvalidValueError("shape of points", self.points.shape, "(n, 3) with n at least 1")
        if self.triangles.ndim != 2 or self.triangles.shape[1] != 3 or len(self.triangles) == 0:
            raise InvalidValueError("shape of triangles", self.triangles.shape, "(m, 3) with m at least 1")
        if self.triangles.min() < 0 or self.triangles.max() >= len(self.points):
            raise InvalidValueError(
                "triangles", (int(self.triangles.min()), int(self.triangles.max())), f"0 to {len(self.points) - 1}"
            )
        if not np.isfinite(self.points).all():
            raise InvalidValueError("points", "an array with NaN or infinity", "finite metres")
        count = len(self.triangles)
        self.object_ids: NDArray[np.uint8] = _spread("object_ids", object_ids, count).astype(np.uint8)
        allowed = [int(i) for i in ObjectId if i is not ObjectId.BACKGROUND]
        if not np.isin(self.object_ids, allowed).all():
            raise InvalidValueError("object_ids", sorted({int(i) for i in self.object_ids}), f"from {allowed}")
        self.albedo_factor: NDArray[np.float32] = _spread("albedo_factor", albedo_factor, len(self.points)).astype(np.float32)
        if not ((self.albedo_factor >= 0.0) & np.isfinite(self.albedo_factor)).all():
            raise InvalidValueError("albedo_factor", "an array with negative or non-finite numbers", "numbers from 0 on")
        self.parts: NDArray[np.int32] = _spread("parts", parts, count).astype(np.int32)
        self._rigid: list[_RigidPart] = []
        self._tissues: list[_TissuePart] = []

    @classmethod
    def from_model(
        cls,
        model: mujoco.MjModel,
        *,
        tissue: TissueSurface | None = None,
        groups: Collection[int] = (1,),
        without: Collection[str] = (),
        rng: np.random.Generator | None = None,
        appearance: TissueAppearance | None = None,
    ) -> "SceneGeometry":
        """Collect the tissue and the geoms of the given groups; call `update` before the first image.

        Geoms become tool, stage or other by the prefix of their names. Fully transparent geoms are left out.

        Args:
            model: The compiled model.
            tissue: The surface that the camera sees of the tissue; by default those of the model's flexes in `groups`.
            groups: Groups that the camera sees.
            without: Names of geoms in them that it does not.
            rng: Source of the tissue's texture, a smooth variation of its albedo; without it the tissue is uniform.
            appearance: Patches and detail on top of that texture; none by default.

        Raises:
            InvalidValueError: If nothing is visible, a visible geom has a type without a surface, or an appearance lacks the
                generator to draw it from.
        """
        appearance = appearance or TissueAppearance()
        if rng is None and not appearance.is_plain:
            raise InvalidValueError("rng", None, "a generator, to draw the tissue's appearance from")
        surfaces: list[primitives.Surface] = []
        ids: list[ObjectId] = []
        rigid: list[_RigidPart] = []
        tissues: list[_TissuePart] = []
        factors: list[NDArray[np.float32]] = []
        start = 0
        flexes = np.flatnonzero(np.isin(model.flex_group, list(groups)))
        seen = [tissue] if tissue is not None else [FlexSurface(model, int(flex)) for flex in flexes]
        for surface in seen:
            rest = surface.rest_points
            surfaces.append((rest, surface.triangles))
            ids.append(ObjectId.TISSUE)
            tissues.append(_TissuePart(surface=surface, rows=slice(start, start + len(rest))))
            uniform = np.ones(len(rest), dtype=np.float32)
            factors.append(uniform if rng is None else tissue_albedo(rest, appearance, rng))
            start += len(rest)
        visible = np.isin(model.geom_group, list(groups)) & (geom_opacity(model) > 0.0)
        for index in np.flatnonzero(visible):
            if model.geom(index).name in without:
                continue
            points, triangles = _geom_surface(model, int(index))
            surfaces.append((points, triangles))
            ids.append(object_id_of_geom(model.geom(index).name))
            rigid.append(_RigidPart(geom=int(index), rows=slice(start, start + len(points)), points_in_geom=points))
            factors.append(np.ones(len(points), dtype=np.float32))
            start += len(points)
        if not surfaces:
            raise InvalidValueError("groups", tuple(groups), "groups that hold at least one geom or flex")
        points, triangles = primitives.join(surfaces)
        counts = [len(t) for _, t in surfaces]
        scene = cls(
            points=points,
            triangles=triangles,
            object_ids=np.repeat([int(i) for i in ids], counts),
            albedo_factor=np.concatenate(factors),
            parts=np.repeat(np.arange(len(surfaces)), counts),
        )
        scene._rigid, scene._tissues = rigid, tissues
        return scene

    def update(self, data: mujoco.MjData) -> None:
        """Move the points to where the tissue and the model's bodies are; make the kinematics current first."""
        for tissue in self._tissues:
            surface = tissue.surface
            self.points[tissue.rows] = surface.points(data) if isinstance(surface, FlexSurface) else surface.surface_points()
        for rigid in self._rigid:
            rotation = data.geom_xmat[rigid.geom].reshape(3, 3)
            self.points[rigid.rows] = rigid.points_in_geom @ rotation.T + data.geom_xpos[rigid.geom]

    def move(self, points: NDArray[np.floating]) -> None:
        """Replace all points of a scene of plain arrays.

        Raises:
            InvalidValueError: If the shape differs from that of the points it was made with.
        """
        if points.shape != self.points.shape:
            raise InvalidValueError("shape of points", points.shape, f"{self.points.shape}")
        self.points[:] = points

    def neighbours(self) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return `offsets` and `pairs`, (k, 2): triangles around vertex i hold `pairs[offsets[i] : offsets[i + 1]]` and i.

        The vertices of a pair are in the triangle's order, behind vertex i.
        """
        return _neighbours(self.triangles.tobytes(), len(self.points))


def _spread(name: str, values: ArrayLike, count: int) -> NDArray[Any]:
    """Return `values` as an array of `count` entries, a single number for all of them."""
    array = np.asarray(values)
    if array.ndim == 0:
        array = np.full(count, array)
    if array.shape != (count,):
        raise InvalidValueError(f"shape of {name}", array.shape, f"({count},)")
    return array


def geom_opacity(model: mujoco.MjModel) -> NDArray[np.float64]:
    """Return the alpha of each geom, its material's where it has one."""
    alpha = np.array(model.geom_rgba[:, 3], dtype=np.float64)
    with_material = model.geom_matid >= 0
    alpha[with_material] = model.mat_rgba[model.geom_matid[with_material], 3]
    return alpha


def _geom_surface(model: mujoco.MjModel, geom: int) -> primitives.Surface:
    """Return the triangles of a geom in its own frame."""
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        points = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
        triangles = model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]
        return primitives.facets(points.astype(np.float64), triangles)
    if kind not in _PRIMITIVES:
        name = model.geom(geom).name or f"number {geom}"
        allowed = ", ".join(sorted(k.name for k in (*_PRIMITIVES, mujoco.mjtGeom.mjGEOM_MESH)))
        raise InvalidValueError(f"type of geom {name}", kind.name, allowed)
    return _primitive(kind, *(float(size) for size in model.geom_size[geom][: _PRIMITIVES[kind][1]]))


@functools.lru_cache(maxsize=4)
def _neighbours(corners: bytes, count: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return `SceneGeometry.neighbours`, read-only, of int32 corners and a number of points: episodes share their triangles."""
    triangles = np.frombuffer(corners, dtype=np.int32).reshape(-1, 3)
    order = np.argsort(triangles.ravel(), kind="stable")
    offsets = np.zeros(count + 1, dtype=np.int32)
    np.cumsum(np.bincount(triangles.ravel(), minlength=count), out=offsets[1:])
    pairs = np.stack([np.roll(triangles, -1, axis=1), np.roll(triangles, -2, axis=1)], axis=-1).reshape(-1, 2)[order]
    offsets.flags.writeable = pairs.flags.writeable = False
    return offsets, pairs


@functools.lru_cache(maxsize=256)
def _primitive(kind: mujoco.mjtGeom, *sizes: float) -> primitives.Surface:
    """Return the triangles of a primitive, read-only: theatres share theirs, and every episode has a theatre."""
    points, triangles = _PRIMITIVES[kind][0](*sizes)
    points.flags.writeable = triangles.flags.writeable = False
    return points, triangles
