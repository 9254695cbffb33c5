"""Warp kernels of the shadows' soft borders: the projector's aperture is a disk, of which a point may see a part.

Launches over pixels are as those of `ray_kernels`; frames as there. Few pixels lie near the border of a shadow: steps in the
projector's depth map say which, and these alone follow rays.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.ray_kernels import LINE_OF_SIGHT
from laploop.envs.sensors.kernels.shading_kernels import Projection, transmitted
from laploop.envs.sensors.kernels.zbuffer_kernels import Projector, View

wp.set_module_options({"enable_backward": False})

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_NOTHING = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))
_NOTHING_M = wp.constant(100.0)
_UNDECIDED = wp.constant(-1.0)
_RAY_END = wp.constant(0.9998)


@wp.func_native("""
int found = 0;
for (int i = low; i < high; ++i) {
    const unsigned long long here = keys.data[i], there = keys.data[i + offset];
    const unsigned int first = (unsigned int)(here >> 32), second = (unsigned int)(there >> 32);
    float z, other;
    memcpy(&z, &first, 4);
    memcpy(&other, &second, 4);
    // What shows nothing is not a number.
    z = z < 100.0f ? z : 100.0f;
    other = other < 100.0f ? other : 100.0f;
    const float step = other - z;
    found |= (step > 0.0f ? step : -step) > least * z * other;
}
return found;
""")
def _has_step(low: int, high: int, offset: int, least: float, keys: wp.array(dtype=wp.uint64)) -> int:
    """Whether inverse depths of pixels from `low` to before `high` and of those at an offset differ by more than `least`."""


@wp.func
def _inverse_depth(keys: wp.array(dtype=wp.uint64), pixel: int):
    key = keys[pixel]
    z = float(_NOTHING_M)
    if key != _NOTHING:
        z = wp.cast(wp.uint32(key >> wp.uint64(32)), wp.float32)
    return 1.0 / z


@wp.kernel
def mark_borders(
    run: int,
    view: View,
    least: float,
    radius: float,
    keys: wp.array(dtype=wp.uint64),
    borders: wp.array(dtype=wp.float32),
):
    """Mark where the borders of shadows may fall on the projector's depth map, by the inverse depth of what casts them.

    The shadow of an edge at z1 on a surface at z2 is soft within `radius` * (1/z1 - 1/z2) pixels, the radius being the
    aperture's times the map's focal length. Marks overlap: on the CPU one thread makes all of them.
    """
    count = view.width * view.height
    start = wp.tid() * run
    for axis in range(2):
        offset = wp.where(axis == 0, 1, view.width)
        stop = wp.min(start + run, count - offset)
        if start < stop and _has_step(start, stop, offset, least, keys) != 0:
            for pixel in range(start, stop):
                here = _inverse_depth(keys, pixel)
                there = _inverse_depth(keys, pixel + offset)
                step = wp.abs(there - here)
                if step > least:
                    nearest = wp.max(here, there)
                    reach = int(wp.min(radius * step, float(view.width))) + 2
                    x = pixel % view.width
                    y = pixel // view.width
                    for v in range(wp.max(y - reach, 0), wp.min(y + reach + 1, view.height)):
                        for u in range(wp.max(x - reach, 0), wp.min(x + reach + 1, view.width)):
                            if borders[v * view.width + u] < nearest:
                                wp.atomic_max(borders, v * view.width + u, nearest)


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
    least: float,
    borders: wp.array(dtype=wp.float32),
    visible: wp.array(dtype=wp.float32),
):
    """Set the fraction of the aperture that a pixel's point sees, 0 or 1; near the border of a shadow it stays undecided."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        seen = wp.where((flags[i] & _LINE_OF_SIGHT) != wp.uint8(0), 1.0, 0.0)
        x = projector.view.focal[0] * tangent[i][0] + projector.view.centre[0]
        y = projector.view.focal[1] * tangent[i][1] + projector.view.centre[1]
        # False where there is no point.
        if x >= 0.0 and y >= 0.0 and x < float(projector.view.width) and y < float(projector.view.height):
            nearest = borders[int(y) * projector.view.width + int(x)]
            if nearest > 0.0:
                point = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0)
                along = wp.dot(projector.axis, point - projector.centre)
                if along > 0.0 and nearest - 1.0 / along > least:
                    seen = _UNDECIDED
        visible[i] = seen


@wp.kernel
def follow_penumbra(
    first: int,
    last: int,
    run: int,
    mesh: wp.uint64,
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3),
    tangent: wp.array(dtype=wp.vec2),
    projector: Projector,
    aperture: wp.array(dtype=wp.vec2),
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projection: Projection,
    visible: wp.array(dtype=wp.float32),
):
    """Decide the undecided pixels by rays to points of the aperture, in metres.

    Each ray carries what the mask transmits along it, so that defocus and shadow go together; the sum over the rays that arrive
    is relative to that over all of them, which is what the mask's table holds.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        if visible[i] < 0.0:
            point = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0)
            from_projector = point - projector.centre
            total = 0.0
            arrived = 0.0
            if wp.dot(normal[i], from_projector) < 0.0:
                way = point[0] * pose[1] + point[1] * pose[2] + point[2] * pose[3] + (pose[0] - pose[4])
                x_c = projector.rotation[0]
                y_c = projector.rotation[1]
                x_axis = x_c[0] * pose[1] + x_c[1] * pose[2] + x_c[2] * pose[3]
                y_axis = y_c[0] * pose[1] + y_c[1] * pose[2] + y_c[2] * pose[3]
                shift = projection.inverse_focus - 1.0 / wp.dot(projector.axis, from_projector)
                for k in range(aperture.shape[0]):
                    on_mask = tangent[i] + shift * aperture[k]
                    light = transmitted(table, stack, projection, projector.half_field, on_mask, 0.0)
                    total += light
                    offset = aperture[k][0] * x_axis + aperture[k][1] * y_axis
                    if light > 0.0 and not wp.mesh_query_ray_anyhit(mesh, pose[4] + offset, way - offset, _RAY_END):
                        arrived += light
            visible[i] = arrived / wp.max(total, 1.0e-9)
