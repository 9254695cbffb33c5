"""Warp kernels of the stripe camera that turn geometry into electrons and grey values; the same code runs on CPU and CUDA.

Launches are over pixels, as those of `ray_kernels`.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.ray_kernels import LINE_OF_SIGHT
from laploop.envs.sensors.kernels.zbuffer_kernels import Projector

wp.set_module_options({"enable_backward": False})

_LINE_OF_SIGHT = wp.constant(wp.uint8(LINE_OF_SIGHT))
_INVERSE_PI = wp.constant(0.31830988618)
_PI = wp.constant(3.14159265359)


@wp.struct
class Projection:
    """The projector's light and blur, for `shade`."""

    intensity_w_sr: float
    led_exponent: float
    stray_fraction: float
    fixed_variance: float
    defocus_slope: float
    inverse_focus: float
    table_start: float
    columns_per_tan: float
    levels_per_tan: float
    """Of the mask's table, and where it begins."""


@wp.struct
class Sensor:
    """Lens and sensor, for `shade`."""

    electrons_per_radiance: float
    vignetting_exponent: float
    levels_per_electron: float
    read_variance: float
    levels: float
    """Largest grey value."""


@wp.func
def _look_up(table: wp.array2d(dtype=wp.float32), column: float, level: float):
    """Interpolate the table linearly in both directions, clamped to its border."""
    x = wp.clamp(column, 0.0, float(table.shape[1]) - 1.001)
    y = wp.clamp(level, 0.0, float(table.shape[0]) - 1.001)
    i = int(x)
    j = int(y)
    fx = x - float(i)
    low = table[j, i] + fx * (table[j, i + 1] - table[j, i])
    high = table[j + 1, i] + fx * (table[j + 1, i + 1] - table[j + 1, i])
    return low + (y - float(j)) * (high - low)


@wp.func
def _look_up_stack(stack: wp.array3d(dtype=wp.float32), column: float, row: float, level: float):
    """Interpolate the stack linearly in its three directions, clamped to its border."""
    x = wp.clamp(column, 0.0, float(stack.shape[2]) - 1.001)
    y = wp.clamp(row, 0.0, float(stack.shape[1]) - 1.001)
    z = wp.clamp(level, 0.0, float(stack.shape[0]) - 1.001)
    i = int(x)
    j = int(y)
    k = int(z)
    fx = x - float(i)
    fy = y - float(j)
    near = float(0.0)
    far = float(0.0)
    for d in range(2):
        low = stack[k + d, j, i] + fx * (stack[k + d, j, i + 1] - stack[k + d, j, i])
        high = stack[k + d, j + 1, i] + fx * (stack[k + d, j + 1, i + 1] - stack[k + d, j + 1, i])
        near = far
        far = low + fy * (high - low)
    return near + (z - float(k)) * (far - near)


@wp.func
def _field_edge(y: float, half: float, sigma: float):
    """Transmission at the mask's lower and upper border, blurred; the left and right borders are in the table."""
    inside = half - wp.abs(y)
    if inside > 4.0 * sigma:
        return 1.0
    if inside < -4.0 * sigma:
        return 0.0
    return 0.5 * (1.0 + wp.erf(inside / (1.41421356 * wp.max(sigma, 1.0e-9))))


@wp.func
def _ggx(n: wp.vec3, light: wp.vec3, view: wp.vec3, reflectance: float, alpha: float):
    """Specular reflectance distribution times the light's cosine, 1/sr (Walter et al. 2007, Smith's masking)."""
    cosine_l = wp.dot(n, light)
    cosine_v = wp.dot(n, view)
    n_l = wp.max(cosine_l, 1.0e-3)
    n_v = wp.max(cosine_v, 1.0e-3)
    # The half vector's cosines follow from those of its two parts, whose sum has the squared length 2 + 2 (light . view).
    half = wp.max(1.0 + wp.dot(light, view), 1.0e-6)
    n_h2 = (cosine_l + cosine_v) * (cosine_l + cosine_v) / (2.0 * half)
    a2 = alpha * alpha
    q = n_h2 * (a2 - 1.0) + 1.0
    masking = n_l * wp.sqrt(a2 + (1.0 - a2) * n_v * n_v) + n_v * wp.sqrt(a2 + (1.0 - a2) * n_l * n_l)
    c = 1.0 - wp.sqrt(0.5 * half)
    c2 = c * c
    fresnel = reflectance + (1.0 - reflectance) * c2 * c2 * c
    return 0.5 * a2 * fresnel * n_l / (_PI * q * q * masking)


@wp.func
def _blur(projection: Projection, depth: float, subsurface: float):
    """Standard deviation of the mask's blur at a depth in the projector's frame, tangent units."""
    inverse_z = 1.0 / depth
    defocus = projection.defocus_slope * (inverse_z - projection.inverse_focus)
    spread = subsurface * inverse_z
    return wp.sqrt(projection.fixed_variance + defocus * defocus + spread * spread)


@wp.func
def _transmission(
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projection: Projection,
    half_field: float,
    tangent: wp.vec2,
    sigma: float,
):
    """Transmission of the mask at a tangent coordinate of the projector, blurred by sigma.

    From the stack unless it is empty: it is for masks that vary along both axes, and includes all four borders.
    """
    column = (tangent[0] - projection.table_start) * projection.columns_per_tan
    level = sigma * projection.levels_per_tan
    if stack.shape[0] > 0:
        row = (tangent[1] - projection.table_start) * projection.columns_per_tan
        return _look_up_stack(stack, column, row, level)
    return _look_up(table, column, level) * _field_edge(tangent[1], half_field, sigma)


@wp.func
def _expected_electrons(
    ray: wp.vec3,
    from_projector: wp.vec3,
    along: float,
    n: wp.vec3,
    material: wp.vec4,
    factor: float,
    light: float,
    projection: Projection,
    sensor: Sensor,
):
    """Photo-electrons of a pixel that sees a point, which gets the fraction `light` of what a clear mask would transmit.

    The way from the projector's centre to the point is given in the camera's frame, and its part along the projector's axis.
    """
    inverse_distance = 1.0 / wp.length(from_projector)
    cosine_p = along * inverse_distance
    if cosine_p <= 0.0:
        return 0.0
    inverse_ray = 1.0 / wp.length(ray)
    irradiance = projection.intensity_w_sr * inverse_distance * inverse_distance
    if projection.led_exponent == 1.0:
        irradiance *= cosine_p
    else:
        irradiance *= wp.pow(cosine_p, projection.led_exponent)
    albedo = material[0] * factor
    radiance = irradiance * projection.stray_fraction * albedo * _INVERSE_PI
    if light > 0.0:
        to_light = -inverse_distance * from_projector
        n_l = wp.dot(n, to_light)
        if n_l > 0.0:
            scattered = albedo * _INVERSE_PI * n_l + _ggx(n, to_light, ray * -inverse_ray, material[1], material[2])
            radiance += irradiance * (1.0 - projection.stray_fraction) * light * scattered
    vignetting = inverse_ray
    if sensor.vignetting_exponent != 1.0:
        vignetting = wp.pow(inverse_ray, sensor.vignetting_exponent)
    return radiance * vignetting * sensor.electrons_per_radiance


@wp.func
def _grey(mean: float, noise: float, sensor: Sensor):
    """Grey value of expected photo-electrons with standard normal noise."""
    # A Poisson variable is all but normal at the counts that matter here; the read noise is normal.
    charge = mean + wp.sqrt(mean + sensor.read_variance) * noise
    grey = wp.floor(charge * sensor.levels_per_electron + 0.5)
    return wp.clamp(grey, 0.0, sensor.levels)


@wp.kernel
def shade(
    first: int,
    last: int,
    run: int,
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3),
    tangent: wp.array(dtype=wp.vec2),
    flags: wp.array(dtype=wp.uint8),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
    projector: Projector,
    materials: wp.array(dtype=wp.vec4),
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projection: Projection,
    sensor: Sensor,
    noise: wp.array(dtype=wp.float32),
    electrons: wp.array(dtype=wp.float32),
    image: wp.array(dtype=wp.uint16),
):
    """Turn what `trace` has found into expected photo-electrons, and those with standard normal `noise` into grey values."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        mean = float(0.0)
        if object_id[i] != wp.uint8(0):
            ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
            from_projector = depth[i] * ray - projector.centre
            along = wp.dot(projector.axis, from_projector)
            material = materials[int(object_id[i])]
            light = float(0.0)
            if (flags[i] & _LINE_OF_SIGHT) != wp.uint8(0):
                sigma = _blur(projection, along, material[3])
                light = _transmission(table, stack, projection, projector.half_field, tangent[i], sigma)
            mean = _expected_electrons(ray, from_projector, along, normal[i], material, factor[i], light, projection, sensor)
        electrons[i] = mean
        image[i] = wp.uint16(_grey(mean, noise[i], sensor))


@wp.kernel
def digitise(
    first: int,
    last: int,
    run: int,
    electrons: wp.array(dtype=wp.float32),
    sensor: Sensor,
    noise: wp.array(dtype=wp.float32),
    image: wp.array(dtype=wp.uint16),
):
    """Turn expected photo-electrons with standard normal `noise` into grey values."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        image[i] = wp.uint16(_grey(electrons[i], noise[i], sensor))


@wp.kernel
def spread(
    first: int,
    last: int,
    run: int,
    source: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    across: int,
    down: int,
    target: wp.array(dtype=wp.float32),
):
    """Blur an image along x (`across` 1, `down` 0) or y (0, 1) with one half of a symmetric filter.

    The image is mirrored at its borders, so that no electron gets lost there.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        x = i % width
        y = i // width
        total = weights[0] * source[i]
        for k in range(1, weights.shape[0]):
            for side in range(2):
                d = k * (2 * side - 1)
                u = x + across * d
                v = y + down * d
                if u < 0:
                    u = -1 - u
                if u >= width:
                    u = 2 * width - 1 - u
                if v < 0:
                    v = -1 - v
                if v >= height:
                    v = 2 * height - 1 - v
                total += weights[k] * source[v * width + u]
        target[i] = total
