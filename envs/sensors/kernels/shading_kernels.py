"""Warp kernels of the stripe camera that turn geometry into electrons and grey values; the same code runs on CPU and CUDA.

Launches are over pixels, as those of `ray_kernels`.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.zbuffer_kernels import Projector

wp.set_module_options({"enable_backward": False})

_INVERSE_PI = wp.constant(0.31830988618)
_PI = wp.constant(3.14159265359)


@wp.struct
class Projection:
    """The projector's light and blur."""

    intensity_w_sr: float
    led_exponent: float
    patterned: float
    """Fraction of the light that is not glare."""
    glare: float
    """Transmission of a mask without pattern that would let the glare through."""
    variance: float
    """Of the blur by source and pixel."""
    radius: float
    """Of the aperture, metres."""
    inverse_focus: float
    table_start: float
    columns_per_tan: float
    levels_per_tan: float
    """Of the mask's table, and where it begins."""


@wp.struct
class Sensor:
    """Sensor and camera response."""

    levels_per_electron: float
    """Gain included."""
    read_variance: float
    levels: float
    """Largest grey value."""
    inverse_gamma: float


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
def transmitted(
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projection: Projection,
    half_field: float,
    tangent: wp.vec2,
    radius: float,
):
    """Transmission of the mask at a tangent coordinate, glare included, blurred by the Gaussian and a disk of that radius.

    From the stack unless it is empty: it is for masks that vary along both axes, and includes all four borders.
    """
    column = (tangent[0] - projection.table_start) * projection.columns_per_tan
    level = radius * projection.levels_per_tan
    # At the field's borders the disk counts as a Gaussian of its variance.
    sigma = wp.sqrt(projection.variance + 0.25 * radius * radius)
    upright = _field_edge(tangent[1], half_field, sigma)
    pattern = float(0.0)
    if stack.shape[0] > 0:
        row = (tangent[1] - projection.table_start) * projection.columns_per_tan
        pattern = _look_up_stack(stack, column, row, level)
    else:
        pattern = _look_up(table, column, level) * upright
    return projection.patterned * pattern + projection.glare * upright * _field_edge(tangent[0], half_field, sigma)


@wp.kernel
def shade(
    first: int,
    last: int,
    run: int,
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.vec3),
    tangent: wp.array(dtype=wp.vec2),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
    visible: wp.array(dtype=wp.float32),
    projector: Projector,
    materials: wp.array(dtype=wp.vec3),
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projection: Projection,
    irradiance: wp.array(dtype=wp.float32),
    albedo: wp.array(dtype=wp.float32),
    gloss: wp.array(dtype=wp.float32),
):
    """Compute the projector's irradiance, W/m², the albedo, and the radiance of specular reflection, W/(m² sr).

    `visible` is the fraction of the projector's light that reaches a point.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        found = float(0.0)
        matte = float(0.0)
        glossy = float(0.0)
        if object_id[i] != wp.uint8(0):
            material = materials[int(object_id[i])]
            matte = material[0] * factor[i]
            if visible[i] > 0.0:
                ray = wp.vec3(rays[i][0], rays[i][1], 1.0)
                from_projector = depth[i] * ray - projector.centre
                along = wp.dot(projector.axis, from_projector)
                inverse_distance = 1.0 / wp.length(from_projector)
                to_light = -inverse_distance * from_projector
                cosine = wp.dot(normal[i], to_light)
                if cosine > 0.0:
                    radius = projection.radius * wp.abs(1.0 / along - projection.inverse_focus)
                    light = transmitted(table, stack, projection, projector.half_field, tangent[i], radius)
                    beam = visible[i] * light * projection.intensity_w_sr * inverse_distance * inverse_distance
                    cosine_p = along * inverse_distance
                    if projection.led_exponent == 1.0:
                        beam *= cosine_p
                    else:
                        beam *= wp.pow(cosine_p, projection.led_exponent)
                    found = beam * cosine
                    view = ray * (-1.0 / wp.length(ray))
                    glossy = beam * _ggx(normal[i], to_light, view, material[1], material[2])
        irradiance[i] = found
        albedo[i] = matte
        gloss[i] = glossy


@wp.kernel
def sum_exitance(
    width: int,
    irradiance: wp.array(dtype=wp.float32),
    albedo: wp.array(dtype=wp.float32),
    sums: wp.array(dtype=wp.vec2),
):
    """Sum each row's radiant exitance, and count its lit pixels."""
    row = wp.tid()
    exitance = float(0.0)
    lit = float(0.0)
    for i in range(row * width, (row + 1) * width):
        exitance += irradiance[i] * albedo[i]
        lit += wp.where(irradiance[i] > 0.0, 1.0, 0.0)
    sums[row] = wp.vec2(exitance, lit)


@wp.kernel
def fill_cavity(cavity_fraction: float, sums: wp.array(dtype=wp.vec2), ambient: wp.array(dtype=wp.float32)):
    """Compute the cavity's irradiance from the rows' sums, in their order: it does not depend on the number of threads."""
    total = wp.vec2(0.0, 0.0)
    for row in range(sums.shape[0]):
        total += sums[row]
    ambient[0] = cavity_fraction * total[0] / wp.max(total[1], 1.0)


@wp.kernel
def expose(
    first: int,
    last: int,
    run: int,
    irradiance: wp.array(dtype=wp.float32),
    albedo: wp.array(dtype=wp.float32),
    gloss: wp.array(dtype=wp.float32),
    ambient: wp.array(dtype=wp.float32),
    falloff: wp.array(dtype=wp.float32),
    electrons_per_radiance: float,
    electrons: wp.array(dtype=wp.float32),
):
    """Turn irradiance into expected photo-electrons; `falloff` is the lens's transmission relative to its axis."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        radiance = albedo[i] * _INVERSE_PI * (irradiance[i] + ambient[0]) + gloss[i]
        electrons[i] = radiance * falloff[i] * electrons_per_radiance


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
        # A Poisson variable is all but normal at the counts that matter here; the read noise is normal.
        charge = electrons[i] + wp.sqrt(electrons[i] + sensor.read_variance) * noise[i]
        grey = charge * sensor.levels_per_electron
        if sensor.inverse_gamma != 1.0:
            grey = sensor.levels * wp.pow(wp.max(grey / sensor.levels, 0.0), sensor.inverse_gamma)
        image[i] = wp.uint16(wp.clamp(wp.floor(grey + 0.5), 0.0, sensor.levels))
