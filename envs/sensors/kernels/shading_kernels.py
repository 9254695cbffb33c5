"""Warp kernels of the stripe camera that turn geometry into electrons and grey values; the same code runs on CPU and CUDA.

Launches are over pixels, as those of `ray_kernels`. Numbers of the optics come in arrays of one entry, so that recorded
launches stay when they change. What is arithmetic without a branch is written in C++, as in `spread_kernels`.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, UP018
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

from laploop.envs.sensors.kernels.zbuffer_kernels import Projector

wp.set_module_options({"enable_backward": False})

_INVERSE_PI = wp.constant(0.31830988618)


@wp.struct
class Projection:
    """The projector's light and blur."""

    intensity_w_sr: float
    led_exponent: float
    patterned: float
    """Fraction of the light that is not glare."""
    glare: float
    """Transmission of a mask without pattern that would let the glare through."""
    sigma: float
    """Of the blur by source and pixel."""
    radius: float
    """Of the aperture, metres."""
    inverse_focus: float
    table_start: float
    columns_per_tan: float
    levels_per_tan: float
    """Of the mask's table, and where it begins."""
    cavity: float
    """Irradiance of the cavity over the mean exitance."""
    ambient: float
    """Irradiance by other lights, W/m²."""


@wp.struct
class Sensor:
    """Sensor and camera response."""

    electrons_per_radiance: float
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
    upright = float(1.0)
    inside = float(1.0)
    if wp.max(wp.abs(tangent[0]), wp.abs(tangent[1])) > half_field - 4.0 * (projection.sigma + 0.5 * radius):
        # At the field's borders the disk counts as a Gaussian of its variance.
        sigma = wp.sqrt(projection.sigma * projection.sigma + 0.25 * radius * radius)
        upright = _field_edge(tangent[1], half_field, sigma)
        inside = upright * _field_edge(tangent[0], half_field, sigma)
    pattern = float(0.0)
    if stack.shape[0] > 0:
        row = (tangent[1] - projection.table_start) * projection.columns_per_tan
        pattern = _look_up_stack(stack, column, row, level)
    else:
        pattern = _look_up(table, column, level) * upright
    return projection.patterned * pattern + projection.glare * inside


@wp.func_native("""
const float* __restrict ray = rays.data;
const float* __restrict z = depth.data;
const float* __restrict n = normal.data;
const float* __restrict part = factor.data;
const float* __restrict of = materials.data;
const unsigned char* __restrict object = object_id.data;
float* __restrict e = irradiance.data;
float* __restrict matte = albedo.data;
float* __restrict shine = gloss.data;
#pragma clang loop vectorize(assume_safety)
for (int i = low; i < high; ++i) {
    const float x = ray[2 * i], y = ray[2 * i + 1];
    const float from_x = z[i] * x - centre[0], from_y = z[i] * y - centre[1], from_z = z[i] - centre[2];
    const float inverse = 1.0f / sqrtf(from_x * from_x + from_y * from_y + from_z * from_z);
    const float towards = -1.0f / sqrtf(x * x + y * y + 1.0f);
    const float along = (axis[0] * from_x + axis[1] * from_y + axis[2] * from_z) * inverse;
    const float cosine_l = -inverse * (n[3 * i] * from_x + n[3 * i + 1] * from_y + n[3 * i + 2] * from_z);
    const float cosine_v = towards * (n[3 * i] * x + n[3 * i + 1] * y + n[3 * i + 2]);
    const float between = -inverse * towards * (from_x * x + from_y * y + from_z);
    const float beam = e[i] * inverse * inverse * along;
    // Specular reflection. The half vector's cosines follow from those of its two parts, whose sum has the squared length
    // 2 + 2 (light . view).
    const float reflectance = of[3 * object[i] + 1], alpha = of[3 * object[i] + 2];
    const float n_l = cosine_l > 1e-3f ? cosine_l : 1e-3f;
    const float n_v = cosine_v > 1e-3f ? cosine_v : 1e-3f;
    const float half = 1.0f + between > 1e-6f ? 1.0f + between : 1e-6f;
    const float n_h2 = (cosine_l + cosine_v) * (cosine_l + cosine_v) / (2.0f * half);
    const float a2 = alpha * alpha;
    const float q = n_h2 * (a2 - 1.0f) + 1.0f;
    const float masking = n_l * sqrtf(a2 + (1.0f - a2) * n_v * n_v) + n_v * sqrtf(a2 + (1.0f - a2) * n_l * n_l);
    const float c = 1.0f - sqrtf(0.5f * half);
    const float fresnel = reflectance + (1.0f - reflectance) * c * c * c * c * c;
    const float specular = 0.5f * a2 * fresnel * n_l / (3.14159265359f * q * q * masking);
    // False where there is no surface.
    const bool lit = beam > 0.0f && cosine_l > 0.0f;
    e[i] = lit ? beam * cosine_l : 0.0f;
    shine[i] = lit ? beam * specular : 0.0f;
    matte[i] = of[3 * object[i]] * part[i];
}
""")
def _reflect(
    low: int,
    high: int,
    centre: wp.vec3,
    axis: wp.vec3,
    rays: wp.array(dtype=wp.float32),
    depth: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.float32),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
    materials: wp.array(dtype=wp.float32),
    irradiance: wp.array(dtype=wp.float32),
    albedo: wp.array(dtype=wp.float32),
    gloss: wp.array(dtype=wp.float32),
):
    """Turn the radiant intensity over cos(angle to the axis), in `irradiance`, into irradiance and reflected light.

    The specular part is GGX with Smith's masking and Schlick's Fresnel term (Walter et al. 2007).
    """


@wp.kernel
def shade(
    first: int,
    last: int,
    run: int,
    rays: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    tangent: wp.array(dtype=wp.vec2),
    visible: wp.array(dtype=wp.float32),
    projector: Projector,
    table: wp.array2d(dtype=wp.float32),
    stack: wp.array3d(dtype=wp.float32),
    projections: wp.array(dtype=Projection),
    flat_rays: wp.array(dtype=wp.float32),
    normal: wp.array(dtype=wp.float32),
    object_id: wp.array(dtype=wp.uint8),
    factor: wp.array(dtype=wp.float32),
    materials: wp.array(dtype=wp.float32),
    irradiance: wp.array(dtype=wp.float32),
    albedo: wp.array(dtype=wp.float32),
    gloss: wp.array(dtype=wp.float32),
):
    """Compute the projector's irradiance, W/m², the albedo, and the radiance of specular reflection, W/(m² sr).

    `visible` is the fraction of the projector's light that reaches a point.
    """
    projection = projections[0]
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    for i in range(start, stop):
        light = float(0.0)
        if visible[i] > 0.0:
            from_projector = depth[i] * wp.vec3(rays[i][0], rays[i][1], 1.0) - projector.centre
            along = wp.dot(projector.axis, from_projector)
            radius = projection.radius * wp.abs(1.0 / along - projection.inverse_focus)
            light = transmitted(table, stack, projection, projector.half_field, tangent[i], radius)
            light *= visible[i] * projection.intensity_w_sr
            if projection.led_exponent != 1.0:
                light *= wp.pow(along / wp.length(from_projector), projection.led_exponent - 1.0)
        irradiance[i] = light
    _reflect(
        start,
        stop,
        projector.centre,
        projector.axis,
        flat_rays,
        depth,
        normal,
        object_id,
        factor,
        materials,
        irradiance,
        albedo,
        gloss,
    )


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
def fill_cavity(projections: wp.array(dtype=Projection), sums: wp.array(dtype=wp.vec2), ambient: wp.array(dtype=wp.float32)):
    """Add the cavity's irradiance to that of other lights, from the rows' sums, in their order: threads do not matter."""
    total = wp.vec2(0.0, 0.0)
    for row in range(sums.shape[0]):
        total += sums[row]
    ambient[0] = projections[0].ambient + projections[0].cavity * total[0] / wp.max(total[1], 1.0)


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
    sensors: wp.array(dtype=Sensor),
    electrons: wp.array(dtype=wp.float32),
):
    """Turn irradiance into expected photo-electrons; `falloff` is the lens's transmission relative to its axis."""
    scale = sensors[0].electrons_per_radiance
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        radiance = albedo[i] * _INVERSE_PI * (irradiance[i] + ambient[0]) + gloss[i]
        electrons[i] = radiance * falloff[i] * scale


@wp.kernel
def digitise(
    first: int,
    last: int,
    run: int,
    electrons: wp.array(dtype=wp.float32),
    sensors: wp.array(dtype=Sensor),
    noise: wp.array(dtype=wp.float32),
    image: wp.array(dtype=wp.uint16),
):
    """Turn expected photo-electrons with standard normal `noise` into grey values."""
    sensor = sensors[0]
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        # A Poisson variable is all but normal at the counts that matter here; the read noise is normal.
        charge = electrons[i] + wp.sqrt(electrons[i] + sensor.read_variance) * noise[i]
        grey = charge * sensor.levels_per_electron
        if sensor.inverse_gamma != 1.0:
            grey = sensor.levels * wp.pow(wp.max(grey / sensor.levels, 0.0), sensor.inverse_gamma)
        image[i] = wp.uint16(wp.clamp(wp.floor(grey + 0.5), 0.0, sensor.levels))
