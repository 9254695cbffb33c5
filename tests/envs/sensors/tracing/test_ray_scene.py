import numpy as np
import warp as wp

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.tracing import primitives
from laploop.envs.sensors.tracing.device import open_device
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.view_tracer import RayScene


def test_normals_are_smooth_on_the_side_of_a_cylinder_and_sharp_at_its_ends():
    points, triangles = primitives.cylinder(0.0025, 0.01)
    scene = RayScene(SceneGeometry(points=points, triangles=triangles, object_ids=ObjectId.TOOL), open_device("cpu"))
    at_vertices = wp.zeros(len(points), dtype=wp.vec3, device="cpu")
    scene.record_normals(scene.points, at_vertices).launch()
    normals = at_vertices.numpy()
    axial = np.abs(normals[:, 2])
    assert ((axial < 1e-4) | (axial > 1.0 - 1e-4)).all()
    side = axial < 0.5
    radial = points[side, :2] / np.linalg.norm(points[side, :2], axis=1, keepdims=True)
    assert (np.sum(normals[side, :2] * radial, axis=1) > np.cos(np.radians(0.1))).all()
