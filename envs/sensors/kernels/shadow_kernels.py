"""Warp kernels of the shadows' soft borders: the projector's aperture is a disk, of which a point may see a part.

Launches over pixels are as those of `ray_kernels`; frames as there. Few pixels lie near the border of a shadow: steps in the
projector's depth map say which; for these alone, rays to points of the aperture are tested against the triangles that the map
shows around the point. A walk through the scene's tree would take ten times as long.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, RUF046, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.ray_kernels import LINE_OF_SIGHT, OWN_SURFACE
from laploop.envs.sensors.kernels.shading_kernels import Projection, transmitted
from laploop.envs.sensors.kernels.zbuffer_kernels import Projector, View

wp.set_module_options({"enable_backward": False})

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_NOTHING = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))
_NOTHING_M = wp.constant(100.0)
_UNDECIDED = wp.constant(-1.0)
_LOWER_HALF = wp.constant(wp.uint64(0xFFFFFFFF))
_ALL = wp.constant(wp.uint32(0xFFFFFFFF))
"""A bit for each point of the aperture."""
Recent = wp.types.vector(length=8, dtype=wp.int32)
"""Triangles or vertices that were the last to be looked at."""
_OWN_SURFACE = wp.constant(OWN_SURFACE)
_NARROW_PX = wp.constant(1.5)
_NARROWEST_PX = wp.constant(0.3)
"""Half width of a penumbra on the projector's depth map, below which it counts as sharp."""


@wp.func
def _penumbra_px(view: View, projection: Projection):
    """Half width of a penumbra on the projector's depth map, in pixels, over the difference of inverse depths."""
    return projection.radius * wp.max(view.focal[0], view.focal[1])


@wp.func
def _depth_m(key: wp.uint64):
    z = float(_NOTHING_M)
    if key != _NOTHING:
        z = wp.cast(wp.uint32(key >> wp.uint64(32)), wp.float32)
    return z


@wp.func
def _inverse_depth(key: wp.uint64):
    return 1.0 / _depth_m(key)


@wp.kernel
def mark_borders(
    run: int,
    view: View,
    projections: wp.array(dtype=Projection),
    keys: wp.array(dtype=wp.uint64),
    borders: wp.array(dtype=wp.float32),
):
    """Mark where the borders of shadows may fall on the projector's depth map, by the inverse depth of what casts them.

    The shadow of an edge at z1 on a surface at z2 is soft within (1/z1 - 1/z2) times the aperture's radius. Marks overlap: on
    the CPU one thread makes all of them.
    """
    radius = _penumbra_px(view, projections[0])
    if radius == 0.0:
        return
    least = _NARROWEST_PX / radius
    count = view.width * view.height
    start = wp.tid() * run
    for axis in range(2):
        offset = wp.where(axis == 0, 1, view.width)
        stop = wp.min(start + run, count - offset)
        for pixel in range(start, stop):
            z = _depth_m(keys[pixel])
            other = _depth_m(keys[pixel + offset])
            # Of inverse depths, without the divisions that few pixels need.
            if wp.abs(other - z) > least * z * other:
                nearest = 1.0 / wp.min(z, other)
                reach = int(wp.min(radius * wp.abs(1.0 / other - 1.0 / z), float(view.width))) + 2
                x = pixel % view.width
                y = pixel // view.width
                for v in range(wp.max(y - reach, 0), wp.min(y + reach + 1, view.height)):
                    for u in range(wp.max(x - reach, 0), wp.min(x + reach + 1, view.width)):
                        if borders[v * view.width + u] < nearest:
                            wp.atomic_max(borders, v * view.width + u, nearest)


@wp.func
def _map_pixel(view: View, tangent: wp.vec2):
    """Pixel of the depth map that a tangent coordinate falls into; -1 outside, and where there is no point."""
    x = view.focal[0] * tangent[0] + view.centre[0]
    y = view.focal[1] * tangent[1] + view.centre[1]
    if x >= 0.0 and y >= 0.0 and x < float(view.width) and y < float(view.height):
        return int(y) * view.width + int(x)
    return -1


@wp.kernel
def find_penumbra(
    first: int,
    last: int,
    run: int,
    depth: wp.array(dtype=wp.float32),
    rays: wp.array(dtype=wp.vec2),
    tangent: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    projector: Projector,
    projections: wp.array(dtype=Projection),
    borders: wp.array(dtype=wp.float32),
    visible: wp.array(dtype=wp.float32),
):
    """Set the fraction of the aperture that a pixel's point sees, 0 or 1; near the border of a shadow it stays undecided."""
    least = _NARROWEST_PX / wp.max(_penumbra_px(projector.view, projections[0]), 1.0e-9)
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        seen = wp.where((flags[i] & _LINE_OF_SIGHT) != wp.uint8(0), 1.0, 0.0)
        pixel = _map_pixel(projector.view, tangent[i])
        if pixel >= 0:
            nearest = borders[pixel]
            if nearest > 0.0:
                point = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0)
                along = wp.dot(projector.axis, point - projector.centre)
                if along > 0.0 and nearest - 1.0 / along > least:
                    seen = _UNDECIDED
        visible[i] = seen


@wp.func
def _covered(a: wp.vec3, b: wp.vec3, c: wp.vec3, height: float, radius: float, disk: wp.array(dtype=wp.float32)):
    """Return a bit for each of 32 points of the aperture whose light a triangle keeps from a point.

    `a`, `b` and `c` give, as a[0] x + a[1] y + a[2], on which side of the planes through the point and an edge an aperture's
    point (x, y) lies; `height` is six times the volume of triangle and point. Its ratio to the sum of the three says where the
    ray meets the triangle; what is within 0.02 % of the way is the point's own surface.
    """
    covered = wp.uint32(int(0))
    for k in range(32):
        on_aperture = wp.vec3(radius * disk[2 * k], radius * disk[2 * k + 1], 1.0)
        first = wp.dot(a, on_aperture)
        second = wp.dot(b, on_aperture)
        third = wp.dot(c, on_aperture)
        own = _OWN_SURFACE * (first + second + third)
        front = first > 0.0 and second > 0.0 and third > 0.0 and height > own
        back = first < 0.0 and second < 0.0 and third < 0.0 and height < own
        if front or back:
            covered = covered | (wp.uint32(1) << wp.uint32(k))
    return covered


@wp.func
def _side(a: wp.vec3, b: wp.vec3, point: wp.vec3):
    """Coefficients of the plane through a point and two vertices, given relative to it, on the aperture's plane."""
    normal = wp.cross(a, b)
    return wp.vec3(normal[0], normal[1], -wp.dot(normal, point))


@wp.func
def _covered_by(
    triangle: wp.vec3i, point: wp.vec3, radius: float, vertices: wp.array(dtype=wp.vec3), disk: wp.array(dtype=wp.float32)
):
    """Bits of the aperture's points that a triangle keeps from a point."""
    a = vertices[triangle[0]] - point
    b = vertices[triangle[1]] - point
    c = vertices[triangle[2]] - point
    height = wp.dot(a, wp.cross(b, c))
    return _covered(_side(a, b, point), _side(b, c, point), _side(c, a, point), height, radius, disk)


@wp.func
def _is_narrow(triangle: wp.vec3i, view: View, vertices: wp.array(dtype=wp.vec3)):
    """Whether a triangle is narrower on the map than what surely holds a pixel's centre."""
    a = vertices[triangle[0]]
    b = vertices[triangle[1]]
    c = vertices[triangle[2]]
    # Behind the projector nothing is narrow: such triangles are large.
    if wp.min(a[2], wp.min(b[2], c[2])) <= 0.0:
        return False
    origin = wp.vec2(a[0], a[1]) / a[2]
    p = wp.vec2(b[0], b[1]) / b[2] - origin
    q = wp.vec2(c[0], c[1]) / c[2] - origin
    longest = wp.sqrt(wp.max(wp.length_sq(p), wp.max(wp.length_sq(q), wp.length_sq(q - p))))
    return wp.abs(p[0] * q[1] - p[1] * q[0]) * view.focal[0] < _NARROW_PX * longest


@wp.func
def _holds(recent: Recent, number: int):
    found = bool(False)
    for k in range(8):
        found = found or recent[k] == number
    return found


@wp.func
def _blocked(
    point: wp.vec3,
    tangent: wp.vec2,
    nearest: float,
    view: View,
    projection: Projection,
    keys: wp.array(dtype=wp.uint64),
    vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.int32),
    offsets: wp.array(dtype=wp.int32),
    pairs: wp.array(dtype=wp.vec2i),
    disk: wp.array(dtype=wp.float32),
):
    """Bits of the aperture's points that triangles around a point of the map, none nearer than `nearest`, keep from it.

    Where surfaces turn away, not every triangle holds the centre of a pixel: those around narrow ones are looked at, too.
    """
    inverse_z = 1.0 / point[2]
    scale = _penumbra_px(view, projection)
    reach = scale * (nearest - inverse_z) + 1.0
    x = view.focal[0] * tangent[0] + view.centre[0] - 0.5
    y = view.focal[1] * tangent[1] + view.centre[1] - 0.5
    blocked = wp.uint32(int(0))
    recent = Recent(-1)
    slot = int(0)
    around = Recent(-1)
    place = int(0)
    for v in range(wp.max(int(y - reach), 0), wp.min(int(y + reach) + 2, view.height)):
        for u in range(wp.max(int(x - reach), 0), wp.min(int(x + reach) + 2, view.width)):
            key = keys[v * view.width + u]
            away = wp.max(wp.max(wp.abs(float(u) - x), wp.abs(float(v) - y)) - 1.0, 0.0)
            if blocked != _ALL and scale * (_inverse_depth(key) - inverse_z) > away:
                face = int(wp.uint32(key & _LOWER_HALF))
                if not _holds(recent, face):
                    recent[slot] = face
                    slot = (slot + 1) % 8
                    triangle = wp.vec3i(corners[3 * face], corners[3 * face + 1], corners[3 * face + 2])
                    blocked = blocked | _covered_by(triangle, point, projection.radius, vertices, disk)
                    if _is_narrow(triangle, view, vertices):
                        for corner in range(3):
                            vertex = triangle[corner]
                            if not _holds(around, vertex):
                                around[place] = vertex
                                place = (place + 1) % 8
                                for k in range(offsets[vertex], offsets[vertex + 1]):
                                    beside = wp.vec3i(vertex, pairs[k][0], pairs[k][1])
                                    blocked = blocked | _covered_by(beside, point, projection.radius, vertices, disk)
    return blocked


@wp.kernel
def settle_penumbra(
    first: int,
    last: int,
    run: int,
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3),
    tangent: wp.array(dtype=wp.vec2),
    keys: wp.array(dtype=wp.uint64),
    borders: wp.array(dtype=wp.float32),
    vertices: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.int32),
    offsets: wp.array(dtype=wp.int32),
    pairs: wp.array(dtype=wp.vec2i),
    projector: Projector,
    disk: wp.array(dtype=wp.float32),
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projections: wp.array(dtype=Projection),
    visible: wp.array(dtype=wp.float32),
):
    """Decide the undecided pixels: which rays to 32 points of the aperture meet triangles that the depth map shows nearby.

    Each ray carries what the mask transmits along it, so that defocus and shadow go together; the sum over the rays that arrive
    is relative to that over all of them, which is what the mask's table holds. `vertices` are in the projector's frame, `disk`
    is the points on the unit disk.
    """
    projection = projections[0]
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        if visible[i] < 0.0:
            in_camera = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0)
            point = projector.rotation * in_camera + projector.offset
            blocked = wp.uint32(_ALL)
            if wp.dot(normal[i], in_camera - projector.centre) < 0.0:
                nearest = borders[_map_pixel(projector.view, tangent[i])]
                blocked = _blocked(
                    point, tangent[i], nearest, projector.view, projection, keys, vertices, corners, offsets, pairs, disk
                )
            found = wp.where(blocked == _ALL, 0.0, 1.0)
            if blocked != _ALL and blocked != wp.uint32(0):
                shift = (projection.inverse_focus - 1.0 / point[2]) * projection.radius
                total = float(0.0)
                arrived = float(0.0)
                for k in range(32):
                    on_mask = tangent[i] + shift * wp.vec2(disk[2 * k], disk[2 * k + 1])
                    light = transmitted(table, stack, projection, projector.half_field, on_mask, 0.0)
                    total += light
                    if ((blocked >> wp.uint32(k)) & wp.uint32(1)) == wp.uint32(0):
                        arrived += light
                found = arrived / wp.max(total, 1.0e-9)
            visible[i] = found
