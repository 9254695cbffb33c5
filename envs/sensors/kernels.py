"""Warp kernels of the stripe camera; the same code runs on CPU and CUDA.

All of them are told where to begin (`first`), so that several threads can share an image. Frames: w is the world, c the
computer-vision camera, p the projector.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, RUF046, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.zbuffer_kernels import View

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
_INVERSE_PI = wp.constant(0.31830988618)
_PI = wp.constant(3.14159265359)


@wp.struct
class Projection:
    """The projector as the camera sees it, and its blur, for `shade`."""

    rotation: wp.mat33
    """p from c."""
    offset: wp.vec3
    half_height: float
    """Half the lit field along y, tangent units."""
    intensity_w_sr: float
    led_exponent: float
    stray_fraction: float
    fixed_variance: float
    defocus_slope: float
    inverse_focus: float
    table_x_min: float
    table_x_step: float
    table_sigma_step: float


@wp.struct
class Sensor:
    """Lens and sensor, for `shade`."""

    electrons_per_radiance: float
    vignetting_exponent: float
    full_well: float
    read_variance: float
    levels: float
    """Largest grey value."""


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
    """Tell whether something stands between the projector's centre and a point; point and facet's normal in its frame.

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
    """Say all about the point that the ray through each pixel's centre hits.

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


@wp.func
def _look_up(table: wp.array2d(dtype=wp.float32), column: float, level: float):
    """Interpolate the table linearly in both directions; outside of it its border goes on."""
    x = wp.clamp(column, 0.0, float(table.shape[1]) - 1.001)
    y = wp.clamp(level, 0.0, float(table.shape[0]) - 1.001)
    i = int(x)
    j = int(y)
    fx = x - float(i)
    low = table[j, i] + fx * (table[j, i + 1] - table[j, i])
    high = table[j + 1, i] + fx * (table[j + 1, i + 1] - table[j + 1, i])
    return low + (y - float(j)) * (high - low)


@wp.func
def _field_edge(y: float, half: float, sigma: float):
    """Transmission of the mask's lower and upper border, blurred; its left and right ones are in the table."""
    inside = half - wp.abs(y)
    if inside > 4.0 * sigma:
        return 1.0
    if inside < -4.0 * sigma:
        return 0.0
    return 0.5 * (1.0 + wp.erf(inside / (1.41421356 * wp.max(sigma, 1.0e-9))))


@wp.func
def _ggx(n: wp.vec3, light: wp.vec3, view: wp.vec3, reflectance: float, alpha: float):
    """Specular reflectance distribution times the light's cosine, 1/sr (Walter et al. 2007, Smith's masking)."""
    n_l = wp.max(wp.dot(n, light), 1.0e-3)
    n_v = wp.max(wp.dot(n, view), 1.0e-3)
    half = wp.normalize(light + view)
    n_h = wp.dot(n, half)
    a2 = alpha * alpha
    q = n_h * n_h * (a2 - 1.0) + 1.0
    distribution = a2 / (_PI * q * q)
    visibility = 0.5 / (n_l * wp.sqrt(a2 + (1.0 - a2) * n_v * n_v) + n_v * wp.sqrt(a2 + (1.0 - a2) * n_l * n_l))
    c = 1.0 - wp.dot(view, half)
    fresnel = reflectance + (1.0 - reflectance) * c * c * c * c * c
    return distribution * visibility * fresnel * n_l


@wp.kernel
def shade(
    first: int,
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    normal_in_camera: wp.array(dtype=wp.vec3),
    projector: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
    materials: wp.array(dtype=wp.vec4),
    table: wp.array2d(dtype=wp.float32),
    projection: Projection,
    sensor: Sensor,
    noise: wp.array(dtype=wp.float32),
    electrons: wp.array(dtype=wp.float32),
    image: wp.array(dtype=wp.uint8),
):
    """Turn geometry into expected photo-electrons, and those with standard normal `noise` into grey values."""
    i = first + wp.tid()
    mean = float(0.0)
    if object_id[i] != wp.uint8(0):
        z = depth[i]
        ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
        point = z * ray
        n = normal_in_camera[i]
        material = materials[int(object_id[i])]
        in_projector = projection.rotation * point + projection.offset
        distance2 = wp.dot(in_projector, in_projector)
        cosine_p = in_projector[2] / wp.sqrt(distance2)
        if cosine_p > 0.0:
            to_light = -wp.normalize(wp.transpose(projection.rotation) * in_projector)
            ray_length = wp.length(ray)
            view = ray * (-1.0 / ray_length)
            irradiance = projection.intensity_w_sr / distance2
            if projection.led_exponent == 1.0:
                irradiance *= cosine_p
            else:
                irradiance *= wp.pow(cosine_p, projection.led_exponent)
            albedo = material[0] * factor[i]
            radiance = irradiance * projection.stray_fraction * albedo * _INVERSE_PI
            n_l = wp.dot(n, to_light)
            if (flags[i] & _LINE_OF_SIGHT) != wp.uint8(0) and n_l > 0.0:
                inverse_z = 1.0 / in_projector[2]
                defocus = projection.defocus_slope * (inverse_z - projection.inverse_focus)
                spread = material[3] * inverse_z
                sigma = wp.sqrt(projection.fixed_variance + defocus * defocus + spread * spread)
                tangent = projector[i]
                column = (tangent[0] - projection.table_x_min) / projection.table_x_step
                light = _look_up(table, column, sigma / projection.table_sigma_step)
                light *= _field_edge(tangent[1], projection.half_height, sigma)
                scattered = albedo * _INVERSE_PI * n_l + _ggx(n, to_light, view, material[1], material[2])
                radiance += irradiance * (1.0 - projection.stray_fraction) * light * scattered
            vignetting = 1.0 / ray_length
            if sensor.vignetting_exponent != 1.0:
                vignetting = wp.pow(vignetting, sensor.vignetting_exponent)
            mean = radiance * vignetting * sensor.electrons_per_radiance
    electrons[i] = mean
    # A Poisson variable is all but normal at the counts that matter here; the read noise is normal.
    charge = mean + wp.sqrt(mean + sensor.read_variance) * noise[i]
    grey = wp.floor(charge * (sensor.levels / sensor.full_well) + 0.5)
    image[i] = wp.uint8(wp.clamp(grey, 0.0, sensor.levels))
