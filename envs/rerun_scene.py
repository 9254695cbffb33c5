"""A MuJoCo model's visible bodies as Rerun entities: shapes once, poses whenever they are asked for."""

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

VISIBLE_GROUPS = (1, 2)
"""Geom groups that are drawn: what the endoscope sees, and the arms with the wall; the rest only collides."""

_QUATERNION_ORDER = [1, 2, 3, 0]
"""MuJoCo's (w, x, y, z) as Rerun's (x, y, z, w)."""


@dataclass(frozen=True, kw_only=True)
class DrawnBody:
    """A body with at least one visible geom."""

    path: str
    body_id: int
    geom_ids: tuple[int, ...]
    moves: bool
    """False for what is welded to the world."""


def drawn_bodies(model: mujoco.MjModel) -> tuple[DrawnBody, ...]:
    """Find the bodies to draw; a body named `camera_arm/wrist` becomes the entity `world/camera_arm/wrist`."""
    return tuple(_drawn_bodies(model))


def _drawn_bodies(model: mujoco.MjModel) -> Iterator[DrawnBody]:
    for body_id in range(model.nbody):
        first = int(model.body_geomadr[body_id])
        geom_ids = tuple(
            geom_id
            for geom_id in range(first, first + int(model.body_geomnum[body_id]))
            if model.geom_group[geom_id] in VISIBLE_GROUPS and model.geom_type[geom_id] != mujoco.mjtGeom.mjGEOM_PLANE
        )
        if geom_ids:
            name = model.body(body_id).name if body_id else "theatre"
            yield DrawnBody(
                path=f"world/{name or f'body_{body_id}'}",
                body_id=body_id,
                geom_ids=geom_ids,
                moves=int(model.body_weldid[body_id]) != 0,
            )


def body_quaternions(data: mujoco.MjData, body_ids: NDArray[np.intp]) -> NDArray[np.float64]:
    """Orientations of bodies in the world, (n, 4), in Rerun's order (x, y, z, w)."""
    quaternions: NDArray[np.float64] = data.xquat[body_ids][:, _QUATERNION_ORDER]
    return quaternions


def log_shapes(stream: rr.RecordingStream, model: mujoco.MjModel, body: DrawnBody) -> None:
    """Log the geoms of a body, static in the body's frame."""
    for number, geom_id in enumerate(body.geom_ids):
        name = model.geom(geom_id).name.rsplit("/", 1)[-1] or f"geom_{number}"
        path = f"{body.path}/{name}"
        pose = rr.Transform3D(
            translation=model.geom_pos[geom_id],
            quaternion=rr.Quaternion(xyzw=model.geom_quat[geom_id][_QUATERNION_ORDER]),
        )
        shape = _shape(model, geom_id)
        if shape is not None:
            stream.log(path, pose, shape, static=True)


def _shape(model: mujoco.MjModel, geom_id: int) -> rr.AsComponents | None:
    """Make the archetype of a geom in the geom's own frame; None for a kind that is never drawn here."""
    material = int(model.geom_matid[geom_id])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom_id]
    color = np.round(np.asarray(rgba) * 255).astype(np.uint8)
    radius, half = float(model.geom_size[geom_id, 0]), float(model.geom_size[geom_id, 1])
    solid = rr.components.FillMode.Solid
    kind = mujoco.mjtGeom(int(model.geom_type[geom_id]))
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return _mesh(model, int(model.geom_dataid[geom_id]), color)
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return rr.Boxes3D(half_sizes=[model.geom_size[geom_id].copy()], colors=[color], fill_mode=solid)
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return rr.Ellipsoids3D(radii=[radius], colors=[color], fill_mode=solid)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return rr.Cylinders3D(lengths=[2 * half], radii=[radius], colors=[color], fill_mode=solid)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        # Rerun's capsule starts at its frame's origin, MuJoCo's is centred on it.
        return rr.Capsules3D(lengths=[2 * half], radii=[radius], translations=[[0, 0, -half]], colors=[color], fill_mode=solid)
    return None


def _mesh(model: mujoco.MjModel, mesh_id: int, color: NDArray[np.uint8]) -> rr.Mesh3D:
    vertices = slice(model.mesh_vertadr[mesh_id], model.mesh_vertadr[mesh_id] + model.mesh_vertnum[mesh_id])
    faces = slice(model.mesh_faceadr[mesh_id], model.mesh_faceadr[mesh_id] + model.mesh_facenum[mesh_id])
    # Corners are not shared between faces, so that edges of the machined links stay sharp.
    corners = model.mesh_vert[vertices][model.mesh_face[faces]].astype(np.float32)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.float32(1e-12))
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        vertex_normals=np.repeat(normals, 3, axis=0),
        triangle_indices=np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3),
        albedo_factor=color,
    )


def vertex_normals(points: NDArray[np.float32], triangles: NDArray[np.integer]) -> NDArray[np.float32]:
    """Area-weighted unit normals, (n, 3), of a mesh with points (n, 3) and triangles (m, 3)."""
    a, b, c = points[triangles[:, 0]], points[triangles[:, 1]], points[triangles[:, 2]]
    face_normals = np.cross(b - a, c - a)
    corners = triangles.ravel()
    normals = np.stack(
        [np.bincount(corners, np.repeat(face_normals[:, axis], 3), minlength=len(points)) for axis in range(3)], axis=1
    )
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return normals.astype(np.float32)
