"""Warp kernels of the stripe camera; the same code runs on CPU and CUDA.

All of them are told where to begin (`first`), so that several threads can share an image. Frames: w is the world, c the
computer-vision camera, p the projector.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

LINE_OF_SIGHT = 1
INSIDE_FIELD = 2

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_INSIDE = wp.constant(wp.uint8(INSIDE_FIELD))
_SHADOW_RAY_END = wp.constant(0.9998)
_INVERSE_PI = wp.constant(0.31830988618)
_PI = wp.constant(3.14159265359)


@wp.struct
class Projection:
    """The projector as the camera sees it, and its blur, for `shade`."""

    rotation: wp.mat33
    """p from c."""
    offset: wp.vec3
    half_field: wp.vec2
    """Half the lit field along x and y, tangent units."""
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
    triangles: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3),
):
    """Average the normals of the triangles around each vertex, weighted by area."""
    vertex = wp.tid()
    total = wp.vec3(0.0, 0.0, 0.0)
    for k in range(offsets[vertex], offsets[vertex + 1]):
        t = 3 * triangles[k]
        a = points[corners[t]]
        total += wp.cross(points[corners[t + 1]] - a, points[corners[t + 2]] - a)
    normals[vertex] = wp.normalize(total)


@wp.kernel
def trace(
    first: int,
    mesh: wp.uint64,
    pose: wp.array(dtype=wp.vec3),
    rays: wp.array(dtype=wp.vec2),
    corners: wp.array(dtype=wp.int32),
    object_ids: wp.array(dtype=wp.uint8),
    normals: wp.array(dtype=wp.vec3),
    albedo_factor: wp.array(dtype=wp.float32),
    projection: Projection,
    depth: wp.array(dtype=wp.float32),
    normal_in_camera: wp.array(dtype=wp.vec3),
    projector: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
):
    """Cast one ray through each pixel's centre and one from the projector's centre to what it hits.

    `pose` holds the camera's centre, its three axes and the projector's centre, in the world.
    """
    i = first + wp.tid()
    ray = rays[i]
    direction = ray[0] * pose[1] + ray[1] * pose[2] + pose[3]
    hit = wp.mesh_query_ray(mesh, pose[0], direction, 1.0e3)
    if hit.result:
        # The ray's z component in the camera is 1, so the ray parameter is the depth.
        depth[i] = hit.t
        k = 3 * hit.face
        a = corners[k]
        b = corners[k + 1]
        c = corners[k + 2]
        w = 1.0 - hit.u - hit.v
        n = wp.normalize(hit.u * normals[a] + hit.v * normals[b] + w * normals[c])
        facet = hit.normal
        if wp.dot(facet, direction) > 0.0:
            facet = -facet
            n = -n
        normal_in_camera[i] = wp.vec3(wp.dot(n, pose[1]), wp.dot(n, pose[2]), wp.dot(n, pose[3]))
        factor[i] = hit.u * albedo_factor[a] + hit.v * albedo_factor[b] + w * albedo_factor[c]
        object_id[i] = object_ids[hit.face]

        from_projector = hit.t * direction + (pose[0] - pose[4])
        in_projector = projection.rotation * (hit.t * wp.vec3(ray[0], ray[1], 1.0)) + projection.offset
        tangent = wp.vec2(in_projector[0] / in_projector[2], in_projector[1] / in_projector[2])
        projector[i] = tangent
        flag = wp.uint8(0)
        if in_projector[2] > 0.0:
            if wp.abs(tangent[0]) <= projection.half_field[0] and wp.abs(tangent[1]) <= projection.half_field[1]:
                flag = _INSIDE
            if wp.dot(facet, from_projector) < 0.0:
                if not wp.mesh_query_ray_anyhit(mesh, pose[4], from_projector, _SHADOW_RAY_END):
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
                light *= _field_edge(tangent[1], projection.half_field[1], sigma)
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
