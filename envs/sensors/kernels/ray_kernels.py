"""Warp kernels that follow rays and light through a scene; the same code runs on CPU and CUDA.

Launches over pixels go from pixel `first` to before `last`, so that several threads can share an image; each of Warp's threads
does a `run` of pixels, which costs less on the CPU. `pose` holds the camera's centre, its three axes and the projector's
centre, in the world. Frames: w is the world, c the computer-vision camera, p the projector.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.zbuffer_kernels import Projector, View

wp.set_module_options({"enable_backward": False})

LINE_OF_SIGHT = 1
INSIDE_FIELD = 2
DOUBTFUL = 4

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_DOUBTFUL = wp.constant(wp.uint8(DOUBTFUL))
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
    last: int,
    run: int,
    points: wp.array(dtype=wp.vec3),
    offsets: wp.array(dtype=wp.int32),
    pairs: wp.array(dtype=wp.vec2i),
    normals: wp.array(dtype=wp.vec3),
):
    """Average the normals of the triangles around each vertex, with the weights that are exact on spheres (Max 1999)."""
    start = wp.tid() * run
    for vertex in range(start, wp.min(start + run, last)):
        total = wp.vec3(0.0, 0.0, 0.0)
        here = points[vertex]
        for k in range(offsets[vertex], offsets[vertex + 1]):
            p = points[pairs[k][0]] - here
            q = points[pairs[k][1]] - here
            lengths = wp.dot(p, p) * wp.dot(q, q)
            if lengths > 0.0:
                total += wp.cross(p, q) / lengths
        normals[vertex] = wp.normalize(total)


@wp.func
def _seen(keys: wp.array(dtype=wp.uint64), pixel: int):
    """Return the depth that a key holds, NaN where it shows nothing."""
    return wp.cast(wp.uint32(keys[pixel] >> wp.uint64(32)), wp.float32)


@wp.func
def _line_of_sight(point: wp.vec3, tangent: wp.vec2, facet: wp.vec3, view: View, keys: wp.array(dtype=wp.uint64)):
    """Return the flags of a point, with its tangent and the facet's normal, of any length, in the projector's frame.

    The projector's depth map answers where its four pixels around the point agree, against the plane of the facet; near the
    edges of shadows, and where the map is too coarse, the line of sight is doubtful.
    """
    x = view.focal[0] * tangent[0] + view.centre[0] - 0.5
    y = view.focal[1] * tangent[1] + view.centre[1] - 0.5
    if x >= 0.0 and y >= 0.0 and x < float(view.width - 1) and y < float(view.height - 1):
        i = int(x)
        j = int(y)
        first = j * view.width + i
        seen_00 = _seen(keys, first)
        seen_10 = _seen(keys, first + 1)
        seen_01 = _seen(keys, first + view.width)
        seen_11 = _seen(keys, first + view.width + 1)
        # The facet's plane meets the ray of a pixel at height over slope, both negative, as the facet looks at the projector;
        # where the slope is not, the pixel counts as nearer. What shows nothing is NaN, and never is.
        height = wp.dot(facet, point)
        along_x = facet[0] * view.step[0]
        along_y = facet[1] * view.step[1]
        slope = facet[2] + along_x * (float(i) + 0.5 - view.centre[0]) + along_y * (float(j) + 0.5 - view.centre[1])
        nearer = (seen_00 + _SAME_SURFACE_M) * slope > height
        nearer = nearer or (seen_10 + _SAME_SURFACE_M) * (slope + along_x) > height
        nearer = nearer or (seen_01 + _SAME_SURFACE_M) * (slope + along_y) > height
        nearer = nearer or (seen_11 + _SAME_SURFACE_M) * (slope + along_x + along_y) > height
        if not nearer:
            return _LINE_OF_SIGHT
        before = point[2] - _OTHER_SURFACE_M
        if seen_00 < before and seen_10 < before and seen_01 < before and seen_11 < before:
            return wp.uint8(0)
    return _LINE_OF_SIGHT | _DOUBTFUL


@wp.kernel
def trace(
    first: int,
    last: int,
    run: int,
    rays: wp.array(dtype=wp.vec2),
    camera_keys: wp.array(dtype=wp.uint64),
    projector_keys: wp.array(dtype=wp.uint64),
    projector: Projector,
    corners: wp.array(dtype=wp.int32),
    vertices: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    albedo_factor: wp.array(dtype=wp.float32),
    object_ids: wp.array(dtype=wp.uint8),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3),
    tangent: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
):
    """Compute depth, normal, projector coordinates, flags, class and albedo of the point behind each pixel's centre.

    Vertices and their normals are in the camera's frame.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        key = camera_keys[i]
        if key != _NOTHING:
            face = int(wp.uint32(key & _LOWER_HALF))
            z = _seen(camera_keys, i)
            depth[i] = z
            object_id[i] = object_ids[face]
            ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
            point = z * ray
            a = corners[3 * face]
            b = corners[3 * face + 1]
            c = corners[3 * face + 2]
            origin = vertices[a]
            ab = vertices[b] - origin
            ac = vertices[c] - origin
            facet = wp.cross(ab, ac)
            from_a = point - origin
            share = 1.0 / wp.dot(facet, facet)
            v = wp.clamp(wp.dot(wp.cross(from_a, ac), facet) * share, 0.0, 1.0)
            w = wp.clamp(wp.dot(wp.cross(ab, from_a), facet) * share, 0.0, 1.0)
            u = 1.0 - v - w
            n = u * normals[a] + v * normals[b] + w * normals[c]
            scale = 1.0 / wp.sqrt(wp.max(wp.dot(n, n), 1.0e-12))
            if wp.dot(facet, ray) > 0.0:
                facet = -facet
                scale = -scale
            normal[i] = scale * n
            factor[i] = u * albedo_factor[a] + v * albedo_factor[b] + w * albedo_factor[c]

            in_projector = projector.rotation * point + projector.offset
            inverse_z = 1.0 / in_projector[2]
            on_mask = wp.vec2(in_projector[0] * inverse_z, in_projector[1] * inverse_z)
            tangent[i] = on_mask
            found = wp.uint8(0)
            if in_projector[2] > 0.0:
                if wp.abs(on_mask[0]) <= projector.half_field and wp.abs(on_mask[1]) <= projector.half_field:
                    found = _INSIDE
                facet_p = projector.rotation * facet
                if wp.dot(facet_p, in_projector) < 0.0:
                    found = found | _line_of_sight(in_projector, on_mask, facet_p, projector.view, projector_keys)
            flags[i] = found
        else:
            nothing = wp.nan
            depth[i] = nothing
            normal[i] = wp.vec3(nothing, nothing, nothing)
            tangent[i] = wp.vec2(nothing, nothing)
            flags[i] = wp.uint8(0)
            object_id[i] = wp.uint8(0)
            factor[i] = 0.0


@wp.kernel
def settle(
    first: int,
    last: int,
    run: int,
    mesh: wp.uint64,
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    flags: wp.array(dtype=wp.uint8),
):
    """Decide the doubtful lines of sight that `trace` has left, by rays from the projector.

    There are few of them, and a kernel that can walk the tree is slow for all the others.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        if (flags[i] & _DOUBTFUL) != wp.uint8(0):
            point = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0)
            way = point[0] * pose[1] + point[1] * pose[2] + point[2] * pose[3] + (pose[0] - pose[4])
            found = flags[i] & ~_DOUBTFUL
            if wp.mesh_query_ray_anyhit(mesh, pose[4], way, _SHADOW_RAY_END):
                found = found & ~_LINE_OF_SIGHT
            flags[i] = found


@wp.kernel
def trace_keys(
    first: int,
    last: int,
    run: int,
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
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
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
