"""Warp kernels that follow rays and light through a scene; the same code runs on CPU and CUDA.

Launches over pixels go from pixel `first` to before `last`, so that several threads can share an image; each of Warp's threads
does a `run` of pixels, which costs less on the CPU. What every pixel goes through is written in C++, as in `spread_kernels`;
products and sums stay apart in it, so that the bits do not depend on what the compiler fuses. `pose` holds the camera's centre,
its three axes and the projector's centre, in the world. Frames: w is the world, c the computer-vision camera, p the projector.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.zbuffer_kernels import Projector

wp.set_module_options({"enable_backward": False})

LINE_OF_SIGHT = 1
INSIDE_FIELD = 2
DOUBTFUL = 4
OWN_SURFACE = 2.0e-4
"""Fraction of the way from a point to the projector within which what a ray meets is the point's own surface."""

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_DOUBTFUL = wp.constant(wp.uint8(DOUBTFUL))
_SHADOW_RAY_END = wp.constant(1.0 - OWN_SURFACE)
_SAME_SURFACE_M = wp.constant(3.0e-4)
_OTHER_SURFACE_M = wp.constant(2.0e-3)
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


@wp.func_native("""
#pragma clang fp contract(off)
const float* __restrict ray = (const float*)rays.data;
const unsigned long long* __restrict shown = (const unsigned long long*)camera_keys.data;
const unsigned long long* __restrict lit = (const unsigned long long*)projector_keys.data;
const int* __restrict corner = corners.data;
const float* __restrict point = (const float*)vertices.data;
const float* __restrict bent = (const float*)normals.data;
const float* __restrict part = albedo_factor.data;
const unsigned char* __restrict of = object_ids.data;
float* __restrict far = depth.data;
float* __restrict n = (float*)normal.data;
float* __restrict mask = (float*)tangent.data;
unsigned char* __restrict flag = flags.data;
unsigned char* __restrict object = object_id.data;
float* __restrict matte = factor.data;
const int width = projector.view.width, height = projector.view.height;
const float focal_x = projector.view.focal[0], focal_y = projector.view.focal[1];
const float centre_x = projector.view.centre[0], centre_y = projector.view.centre[1];
const float step_x = projector.view.step[0], step_y = projector.view.step[1];
float turn[9], shift[3];
for (int k = 0; k < 9; ++k) turn[k] = projector.rotation.data[k / 3][k % 3];
for (int k = 0; k < 3; ++k) shift[k] = projector.offset[k];
#pragma clang loop vectorize(assume_safety)
for (int i = low; i < high; ++i) {
    const unsigned long long key = shown[i];
    const bool hit = key != 0xFFFFFFFFFFFFFFFFull;
    const int face = hit ? (int)(unsigned int)key : 0;
    const unsigned int bits = (unsigned int)(key >> 32);
    float z;
    memcpy(&z, &bits, 4);
    const int a = 3 * corner[3 * face], b = 3 * corner[3 * face + 1], c = 3 * corner[3 * face + 2];
    const float x = z * ray[2 * i], y = z * ray[2 * i + 1];
    const float a_x = point[a], a_y = point[a + 1], a_z = point[a + 2];
    const float p_x = point[b] - a_x, p_y = point[b + 1] - a_y, p_z = point[b + 2] - a_z;
    const float q_x = point[c] - a_x, q_y = point[c + 1] - a_y, q_z = point[c + 2] - a_z;
    float f_x = p_y * q_z - p_z * q_y, f_y = p_z * q_x - p_x * q_z, f_z = p_x * q_y - p_y * q_x;
    const float r_x = x - a_x, r_y = y - a_y, r_z = z - a_z;
    const float share = 1.0f / (f_x * f_x + f_y * f_y + f_z * f_z);
    float v = (r_y * q_z - r_z * q_y) * f_x + (r_z * q_x - r_x * q_z) * f_y + (r_x * q_y - r_y * q_x) * f_z;
    float w = (p_y * r_z - p_z * r_y) * f_x + (p_z * r_x - p_x * r_z) * f_y + (p_x * r_y - p_y * r_x) * f_z;
    v *= share;
    w *= share;
    v = v > 0.0f ? v : 0.0f;
    v = v < 1.0f ? v : 1.0f;
    w = w > 0.0f ? w : 0.0f;
    w = w < 1.0f ? w : 1.0f;
    const float u = 1.0f - v - w;
    const float n_x = u * bent[a] + v * bent[b] + w * bent[c];
    const float n_y = u * bent[a + 1] + v * bent[b + 1] + w * bent[c + 1];
    const float n_z = u * bent[a + 2] + v * bent[b + 2] + w * bent[c + 2];
    const float squared = n_x * n_x + n_y * n_y + n_z * n_z;
    // Facet and normal look at the camera.
    const float side = f_x * ray[2 * i] + f_y * ray[2 * i + 1] + f_z > 0.0f ? -1.0f : 1.0f;
    const float scale = side / sqrtf(squared > 1e-12f ? squared : 1e-12f);
    f_x *= side;
    f_y *= side;
    f_z *= side;
    // In the projector's frame.
    const float s_x = turn[0] * x + turn[1] * y + turn[2] * z + shift[0];
    const float s_y = turn[3] * x + turn[4] * y + turn[5] * z + shift[1];
    const float s_z = turn[6] * x + turn[7] * y + turn[8] * z + shift[2];
    const float g_x = turn[0] * f_x + turn[1] * f_y + turn[2] * f_z;
    const float g_y = turn[3] * f_x + turn[4] * f_y + turn[5] * f_z;
    const float g_z = turn[6] * f_x + turn[7] * f_y + turn[8] * f_z;
    const float inverse_z = 1.0f / s_z;
    const float m_x = s_x * inverse_z, m_y = s_y * inverse_z;
    const bool in_field = (m_x < 0.0f ? -m_x : m_x) <= half_field && (m_y < 0.0f ? -m_y : m_y) <= half_field;
    const float at = g_x * s_x + g_y * s_y + g_z * s_z;
    // The projector's depth map, which answers where its four pixels around the point agree, against the facet's plane.
    const float map_x = focal_x * m_x + centre_x - 0.5f, map_y = focal_y * m_y + centre_y - 0.5f;
    const bool on_map = map_x >= 0.0f && map_y >= 0.0f && map_x < (float)(width - 1) && map_y < (float)(height - 1);
    const int column = on_map ? (int)map_x : 0, row = on_map ? (int)map_y : 0;
    const int first = row * width + column;
    const unsigned int bits_00 = (unsigned int)(lit[first] >> 32), bits_10 = (unsigned int)(lit[first + 1] >> 32);
    const unsigned int bits_01 = (unsigned int)(lit[first + width] >> 32);
    const unsigned int bits_11 = (unsigned int)(lit[first + width + 1] >> 32);
    float z_00, z_10, z_01, z_11;
    memcpy(&z_00, &bits_00, 4);
    memcpy(&z_10, &bits_10, 4);
    memcpy(&z_01, &bits_01, 4);
    memcpy(&z_11, &bits_11, 4);
    // That plane meets the ray of a pixel at height over slope, both negative, as the facet looks at the projector; where the
    // slope is not, the pixel counts as nearer. What shows nothing is NaN, and never is.
    const float along_x = g_x * step_x, along_y = g_y * step_y;
    const float slope = g_z + along_x * ((float)column + 0.5f - centre_x) + along_y * ((float)row + 0.5f - centre_y);
    const bool nearer = ((z_00 + same_m) * slope > at) | ((z_10 + same_m) * (slope + along_x) > at)
        | ((z_01 + same_m) * (slope + along_y) > at) | ((z_11 + same_m) * (slope + along_x + along_y) > at);
    const float before = s_z - other_m;
    const bool hidden = (z_00 < before) & (z_10 < before) & (z_01 < before) & (z_11 < before);
    // The flags as numbers: in line of sight 1, inside the field 2, doubtful 4.
    const int agreed = nearer ? (hidden ? 0 : 5) : 1;
    const int sight = at < 0.0f ? (on_map ? agreed : 5) : 0;
    far[i] = hit ? z : nothing;
    n[3 * i] = hit ? scale * n_x : nothing;
    n[3 * i + 1] = hit ? scale * n_y : nothing;
    n[3 * i + 2] = hit ? scale * n_z : nothing;
    mask[2 * i] = hit ? m_x : nothing;
    mask[2 * i + 1] = hit ? m_y : nothing;
    matte[i] = hit ? u * part[a / 3] + v * part[b / 3] + w * part[c / 3] : 0.0f;
    object[i] = hit ? of[face] : 0;
    flag[i] = hit && s_z > 0.0f ? (unsigned char)(sight | (in_field ? 2 : 0)) : 0;
}
""")
def _trace(
    low: int,
    high: int,
    same_m: float,
    other_m: float,
    half_field: float,
    nothing: float,
    projector: Projector,
    rays: wp.array(dtype=wp.vec2),
    camera_keys: wp.array(dtype=wp.uint64),
    projector_keys: wp.array(dtype=wp.uint64),
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
    """As `trace`, for the pixels from `low` to before `high`; `nothing` is NaN.

    Near the edges of shadows, and where the projector's depth map is too coarse, the line of sight is doubtful.
    """


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
    _trace(
        start,
        wp.min(start + run, last),
        _SAME_SURFACE_M,
        _OTHER_SURFACE_M,
        projector.half_field,
        wp.nan,
        projector,
        rays,
        camera_keys,
        projector_keys,
        corners,
        vertices,
        normals,
        albedo_factor,
        object_ids,
        depth,
        normal,
        tangent,
        flags,
        object_id,
        factor,
    )


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
