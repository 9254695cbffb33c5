"""Warp kernels that follow rays and light through a scene; the same code runs on CPU and CUDA.

Launches over pixels begin at pixel `first`, so that several threads can share an image. Frames: w is the world, c the
computer-vision camera, p the projector.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, RUF046, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.zbuffer_kernels import View

wp.set_module_options({"enable_backward": False})

LINE_OF_SIGHT = 1
INSIDE_FIELD = 2

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_INSIDE = wp.constant(wp.uint8(INSIDE_FIELD))
_SHADOW_RAY_END = wp.constant(0.9998)
_SAME_SURFACE_M = wp.constant(3.0e-4)
_OTHER_SURFACE_M = wp.constant(2.0e-3)
_NOTHING = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))
_LOWER_HALF = wp.constant(wp.uint64(0xFFFFFFFF))
_NEAR_M = wp.constant(1.0e-3)
_FAR_M = wp.constant(100.0)


@wp.kernel
def vertex_normals(
    points: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.int32),
    offsets: wp.array(dtype=wp.int32),
    around: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3),
):
    """Average the normals of the triangles around each vertex, with the weights that are exact on spheres (Max 1999)."""
    vertex = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    here = points[vertex]
    for k in range(offsets[vertex], offsets[vertex + 1]):
        corner = around[k]
        triangle = corner // 3
        p = points[corners[3 * triangle + (corner + 1) % 3]] - here
        q = points[corners[3 * triangle + (corner + 2) % 3]] - here
        lengths = wp.dot(p, p) * wp.dot(q, q)
        if lengths > 0.0:
            total += wp.cross(p, q) / lengths
    normals[vertex] = wp.normalize(total)


@wp.func
def _in_shadow(
    mesh: wp.uint64,
    from_world: wp.vec3,
    direction_world: wp.vec3,
    point: wp.vec3,
    facet: wp.vec3,
    view: View,
    keys: wp.array(dtype=wp.uint64),
):
    """Return whether something blocks the light to a point; point and facet's normal in the projector's frame.

    The projector's depth map answers where its four pixels around the point agree, against the plane of the facet; near the
    edges of shadows, and where the map is too coarse, a ray decides.
    """
    x = view.focal[0] * point[0] / point[2] + view.centre[0] - 0.5
    y = view.focal[1] * point[1] / point[2] + view.centre[1] - 0.5
    if x >= 0.0 and y >= 0.0 and x < float(view.width - 1) and y < float(view.height - 1):
        height = wp.dot(facet, point)
        nearer = int(0)
        far_nearer = int(0)
        for k in range(4):
            i = int(x) + (k & 1)
            j = int(y) + (k >> 1)
            ray = wp.vec3(
                (float(i) + 0.5 - view.centre[0]) / view.focal[0], (float(j) + 0.5 - view.centre[1]) / view.focal[1], 1.0
            )
            seen = wp.cast(wp.uint32(keys[j * view.width + i] >> wp.uint64(32)), wp.float32)
            slope = wp.dot(facet, ray)
            # Both are negative: the facet looks at the projector. Where the ray misses the plane, a ray must decide.
            expected = wp.where(slope < 0.0, height / slope, 1.0e6)
            if seen < expected - _SAME_SURFACE_M:
                nearer += 1
            if seen < point[2] - _OTHER_SURFACE_M:
                far_nearer += 1
        if nearer == 0:
            return False
        if far_nearer == 4:
            return True
    return wp.mesh_query_ray_anyhit(mesh, from_world, direction_world, _SHADOW_RAY_END)


@wp.kernel
def trace(
    first: int,
    mesh: wp.uint64,
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),
    camera_keys: wp.array(dtype=wp.uint64),
    projector_keys: wp.array(dtype=wp.uint64),
    projector_view: View,
    vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.int32),
    object_ids: wp.array(dtype=wp.uint8),
    normals: wp.array(dtype=wp.vec3),
    albedo_factor: wp.array(dtype=wp.float32),
    projector_from_camera: wp.mat33,
    offset: wp.vec3,
    half_field: wp.vec2,
    depth: wp.array(dtype=wp.float32),
    normal_in_camera: wp.array(dtype=wp.vec3),
    projector: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
):
    """Compute depth, normal, projector coordinates, shadow, class and albedo of the point behind each pixel's centre.

    `pose` holds the camera's centre, its three axes and the projector's centre, in the world; `vertices` are in the camera's
    frame, `normals` in the world.
    """
    i = first + wp.tid()
    key = camera_keys[i]
    if key != _NOTHING:
        face = int(wp.uint32(key & _LOWER_HALF))
        z = wp.cast(wp.uint32(key >> wp.uint64(32)), wp.float32)
        depth[i] = z
        object_id[i] = object_ids[face]
        ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
        point = z * ray
        a = corners[3 * face]
        b = corners[3 * face + 1]
        c = corners[3 * face + 2]
        ab = vertices[b] - vertices[a]
        ac = vertices[c] - vertices[a]
        facet = wp.cross(ab, ac)
        from_a = point - vertices[a]
        area2 = wp.dot(facet, facet)
        v = wp.clamp(wp.dot(wp.cross(from_a, ac), facet) / area2, 0.0, 1.0)
        w = wp.clamp(wp.dot(wp.cross(ab, from_a), facet) / area2, 0.0, 1.0)
        u = 1.0 - v - w
        facet = wp.normalize(facet)
        n = wp.normalize(u * normals[a] + v * normals[b] + w * normals[c])
        n = wp.vec3(wp.dot(n, pose[1]), wp.dot(n, pose[2]), wp.dot(n, pose[3]))
        if wp.dot(facet, ray) > 0.0:
            facet = -facet
            n = -n
        normal_in_camera[i] = n
        factor[i] = u * albedo_factor[a] + v * albedo_factor[b] + w * albedo_factor[c]

        in_projector = projector_from_camera * point + offset
        tangent = wp.vec2(in_projector[0] / in_projector[2], in_projector[1] / in_projector[2])
        projector[i] = tangent
        flag = wp.uint8(0)
        if in_projector[2] > 0.0:
            if wp.abs(tangent[0]) <= half_field[0] and wp.abs(tangent[1]) <= half_field[1]:
                flag = _INSIDE
            facet_p = projector_from_camera * facet
            if wp.dot(facet_p, in_projector) < 0.0:
                from_projector = point[0] * pose[1] + point[1] * pose[2] + point[2] * pose[3] + (pose[0] - pose[4])
                if not _in_shadow(mesh, pose[4], from_projector, in_projector, facet_p, projector_view, projector_keys):
                    flag = flag | _LINE_OF_SIGHT
        flags[i] = flag
    else:
        nothing = wp.nan
        depth[i] = nothing
        normal_in_camera[i] = wp.vec3(nothing, nothing, nothing)
        projector[i] = wp.vec2(nothing, nothing)
        flags[i] = wp.uint8(0)
        object_id[i] = wp.uint8(0)
        factor[i] = 0.0


@wp.kernel
def trace_keys(
    first: int,
    mesh: wp.uint64,
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),
    vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.uint64),
):
    """Find the nearest triangle along each ray, of any lens, in the tree; keys are those of `rasterise`.

    `vertices` are in the camera's frame.
    """
    i = first + wp.tid()
    ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
    direction = ray[0] * pose[1] + ray[1] * pose[2] + pose[3]
    hit = wp.mesh_query_ray(mesh, pose[0] + _NEAR_M * direction, direction, _FAR_M)
    if hit.result:
        a = vertices[corners[3 * hit.face]]
        b = vertices[corners[3 * hit.face + 1]]
        c = vertices[corners[3 * hit.face + 2]]
        normal = wp.cross(b - a, c - a)
        slope = wp.dot(normal, ray)
        z = hit.t + _NEAR_M
        if slope != 0.0:
            # The plane's depth in the camera's own frame, where numbers are small; the tree's is in the world's.
            nearest = wp.max(wp.min(a[2], wp.min(b[2], c[2])), _NEAR_M)
            z = wp.clamp(wp.dot(a, normal) / slope, nearest, wp.max(a[2], wp.max(b[2], c[2])))
        keys[i] = (wp.uint64(wp.cast(z, wp.uint32)) << wp.uint64(32)) | wp.uint64(hit.face)
