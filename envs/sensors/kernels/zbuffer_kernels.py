"""Warp kernels that find the first triangle behind each pixel's centre, for the camera's and the projector's eye.

What comes out is what rays through the pixels' centres hit, ten times faster than walking a tree on the CPU. Every launch owns
whole rows, so that CPU threads never write to the same pixel; on CUDA the minimum is atomic. Equal depths go to the triangle
with the smaller number: the result does not depend on the order of execution. The loop over a triangle's pixels is written in
C++, as in `ray_kernels`.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

wp.set_module_options({"enable_backward": False})

_NEAR_M = wp.constant(1.0e-3)
_EDGE_SLACK = wp.constant(1.0e-5)


@wp.struct
class View:
    """A pinhole; pixel centres at +0.5, lengths in pixels."""

    width: int
    height: int
    focal: wp.vec2
    step: wp.vec2
    """One over `focal`."""
    centre: wp.vec2


@wp.struct
class Projector:
    """Where the projector is, and what of it the mask's field is."""

    rotation: wp.mat33
    """p from c."""
    offset: wp.vec3
    centre: wp.vec3
    axis: wp.vec3
    """Its centre and its z axis, in c."""
    half_field: float
    """Half the width of the mask, tangent units."""
    view: View
    """That of its depth map."""


@wp.func
def _to_pixels(view: View, p: wp.vec3):
    inverse_z = 1.0 / p[2]
    return wp.vec2(view.focal[0] * p[0] * inverse_z + view.centre[0], view.focal[1] * p[1] * inverse_z + view.centre[1])


@wp.kernel
def to_views(
    points: wp.array(dtype=wp.vec3),
    pose: wp.array(dtype=wp.vec3),
    camera: View,
    projector: Projector,
    in_camera: wp.array(dtype=wp.vec3),
    on_camera: wp.array(dtype=wp.vec2),
    in_projector: wp.array(dtype=wp.vec3),
    on_projector: wp.array(dtype=wp.vec2),
):
    """Map world points to the camera's and the projector's frame and onto their pixels; `pose` as in `ray_kernels`."""
    i = wp.tid()
    d = points[i] - pose[0]
    p = wp.vec3(wp.dot(d, pose[1]), wp.dot(d, pose[2]), wp.dot(d, pose[3]))
    q = projector.rotation * p + projector.offset
    in_camera[i] = p
    on_camera[i] = _to_pixels(camera, p)
    in_projector[i] = q
    on_projector[i] = _to_pixels(projector.view, q)


@wp.func
def _clipped_bounds(view: View, a: wp.vec3, b: wp.vec3, box: wp.vec4):
    """Grow the box (low x, low y, high x, high y; pixels) by the part of the edge from a to b before the eye."""
    near = float(_NEAR_M)
    if a[2] < near and b[2] < near:
        return box
    start = a
    end = b
    if a[2] < near:
        start = a + (b - a) * ((near - a[2]) / (b[2] - a[2]))
    if b[2] < near:
        end = a + (b - a) * ((near - a[2]) / (b[2] - a[2]))
    p = _to_pixels(view, start)
    q = _to_pixels(view, end)
    return wp.vec4(
        wp.min(box[0], wp.min(p[0], q[0])),
        wp.min(box[1], wp.min(p[1], q[1])),
        wp.max(box[2], wp.max(p[0], q[0])),
        wp.max(box[3], wp.max(p[1], q[1])),
    )


@wp.func
def _side(origin: wp.vec2, edge: wp.vec2, at: wp.vec2):
    """On which side of an edge a point lies: the sign of the cross product."""
    return edge[0] * (at[1] - origin[1]) - edge[1] * (at[0] - origin[0])


@wp.func
def _keep_nearest(
    height: float,
    slope: float,
    nearest: float,
    farthest: float,
    triangle: int,
    pixel: int,
    keys: wp.array(dtype=wp.uint64),
):
    """Offer the triangle, at the depth where the pixel's ray meets its plane, to the pixel."""
    if slope != 0.0:
        z = wp.clamp(height / slope, nearest, farthest)
        key = (wp.uint64(wp.cast(z, wp.uint32)) << wp.uint64(32)) | wp.uint64(triangle)
        if key < keys[pixel]:
            wp.atomic_min(keys, pixel, key)


@wp.func_native("""
#pragma clang fp contract(off)
unsigned long long* seen = (unsigned long long*)keys.data;
for (int y = y0; y <= y1; ++y) {
    const float at_y = (float)y + 0.5f;
    const float part = normal[1] * (at_y - view.centre[1]) * view.step[1] + normal[2];
    bool entered = false;
    for (int x = x0; x <= x1; ++x) {
        const int pixel = y * view.width + x;
        if (seen[pixel] < first_key) continue;
        const float at_x = (float)x + 0.5f;
        if (ea[0] * (at_y - pb[1]) - ea[1] * (at_x - pb[0]) >= slack[0]
            && eb[0] * (at_y - pc[1]) - eb[1] * (at_x - pc[0]) >= slack[1]
            && ec[0] * (at_y - pa[1]) - ec[1] * (at_x - pa[0]) >= slack[2]) {
            entered = true;
            const float slope = normal[0] * (at_x - view.centre[0]) * view.step[0] + part;
            if (slope != 0.0f) {
                float z = height / slope;
                z = z > nearest ? z : nearest;
                z = z < farthest ? z : farthest;
                unsigned int bits;
                memcpy(&bits, &z, 4);
                const unsigned long long key = (unsigned long long)bits << 32 | (unsigned int)triangle;
                if (key < seen[pixel]) wp::atomic_min(keys, pixel, (wp::uint64)key);
            }
        } else if (entered) {
            break;
        }
    }
}
""")
def _fill(
    triangle: int,
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    view: View,
    height: float,
    nearest: float,
    farthest: float,
    normal: wp.vec3,
    pa: wp.vec2,
    pb: wp.vec2,
    pc: wp.vec2,
    ea: wp.vec2,
    eb: wp.vec2,
    ec: wp.vec2,
    slack: wp.vec3,
    first_key: wp.uint64,
    keys: wp.array(dtype=wp.uint64),
):
    """Offer a triangle before the eye to the pixels of a box, ends included, whose centres lie on the inner side of its edges.

    Corner a faces the edge `ea`, which starts at b, and so on around.
    """


@wp.func
def _offer(
    triangle: int,
    low_row: int,
    high_row: int,
    view: View,
    vertices: wp.array(dtype=wp.vec3),
    pixels: wp.array(dtype=wp.vec2),
    corners: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.uint64),
):
    """Offer a triangle to the pixels between two rows, the second excluded."""
    ia = corners[3 * triangle]
    ib = corners[3 * triangle + 1]
    ic = corners[3 * triangle + 2]
    a = vertices[ia]
    b = vertices[ib]
    c = vertices[ic]
    nearest = wp.min(a[2], wp.min(b[2], c[2]))
    farthest = wp.max(a[2], wp.max(b[2], c[2]))
    if farthest < _NEAR_M:
        return
    pa = pixels[ia]
    pb = pixels[ib]
    pc = pixels[ic]
    whole = nearest >= _NEAR_M
    box = wp.vec4(1.0e9, 1.0e9, -1.0e9, -1.0e9)
    if whole:
        box = wp.vec4(
            wp.min(pa[0], wp.min(pb[0], pc[0])),
            wp.min(pa[1], wp.min(pb[1], pc[1])),
            wp.max(pa[0], wp.max(pb[0], pc[0])),
            wp.max(pa[1], wp.max(pb[1], pc[1])),
        )
    else:
        box = _clipped_bounds(view, a, b, box)
        box = _clipped_bounds(view, b, c, box)
        box = _clipped_bounds(view, c, a, box)
    # The range is cut in floating point: far outside, a pixel number does not fit an integer.
    x0 = int(wp.ceil(wp.clamp(box[0] - 0.501, 0.0, float(view.width))))
    x1 = int(wp.floor(wp.clamp(box[2] - 0.499, -1.0, float(view.width) - 1.0)))
    y0 = int(wp.ceil(wp.clamp(box[1] - 0.501, float(low_row), float(high_row))))
    y1 = int(wp.floor(wp.clamp(box[3] - 0.499, float(low_row) - 1.0, float(high_row) - 1.0)))
    if x0 > x1 or y0 > y1:
        return

    normal = wp.cross(b - a, c - a)
    height = wp.dot(a, normal)
    nearest = wp.max(nearest, float(_NEAR_M))
    # What a pixel already shows may be nearer than all of the triangle.
    first_key = wp.uint64(wp.cast(nearest, wp.uint32)) << wp.uint64(32)
    if whole:
        flip = float(1.0)
        if _side(pa, pb - pa, pc) < 0.0:
            flip = -1.0
        ea = (pc - pb) * flip
        eb = (pa - pc) * flip
        ec = (pb - pa) * flip
        slack = -_EDGE_SLACK * wp.vec3(
            wp.abs(ea[0]) + wp.abs(ea[1]), wp.abs(eb[0]) + wp.abs(eb[1]), wp.abs(ec[0]) + wp.abs(ec[1])
        )
        _fill(triangle, x0, x1, y0, y1, view, height, nearest, farthest, normal, pa, pb, pc, ea, eb, ec, slack, first_key, keys)
    else:
        # Part of the triangle lies behind the eye: its edges are planes through the eye instead of lines in the image.
        turn = wp.where(height < 0.0, -1.0, 1.0)
        bc = wp.cross(b, c) * turn
        ca = wp.cross(c, a) * turn
        ab = wp.cross(a, b) * turn
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                ray = wp.vec3(
                    (float(x) + 0.5 - view.centre[0]) * view.step[0], (float(y) + 0.5 - view.centre[1]) * view.step[1], 1.0
                )
                if wp.dot(bc, ray) >= 0.0 and wp.dot(ca, ray) >= 0.0 and wp.dot(ab, ray) >= 0.0:
                    _keep_nearest(height, wp.dot(normal, ray), nearest, farthest, triangle, y * view.width + x, keys)


@wp.kernel
def rasterise(
    first: int,
    rows: int,
    run: int,
    view: View,
    vertices: wp.array(dtype=wp.vec3),
    pixels: wp.array(dtype=wp.vec2),
    corners: wp.array(dtype=wp.int32),
    keys: wp.array(dtype=wp.uint64),
):
    """Keep the nearest triangle at each pixel's centre: depth in the upper half of the key, number in the lower.

    The launch is (strips, runs of triangles); a strip has `rows` rows. Vertices are in the eye's frame, `pixels` their images.
    """
    strip, part = wp.tid()
    low_row = (first + strip) * rows
    high_row = wp.min(low_row + rows, view.height)
    for triangle in range(part * run, wp.min((part + 1) * run, corners.shape[0] // 3)):
        _offer(triangle, low_row, high_row, view, vertices, pixels, corners, keys)
