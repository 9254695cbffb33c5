"""Warp kernels that spread light over an image, under surfaces and in the lens; the same code runs on CPU and CUDA.

Launches are over pixels, as those of `ray_kernels`. The innermost loops run along a row and are written in C++: the compiler
turns them into vector instructions, which it cannot do with Warp's own loops, and the CPU takes a tenth of the time.
"""

# mypy: ignore-errors
# ruff: noqa: ANN201, ANN202, ARG001
# Kernels are written in Warp's language, whose types and casts are not Python's.

import warp as wp

wp.set_module_options({"enable_backward": False})

_LAYER_M = wp.constant(8.0)
_FAR_LAYER_M = wp.constant(-1000.0)
_NO_SPREAD = wp.constant(1.0e12)


@wp.struct
class Pixels:
    """The image's size, and the tangent coordinates of its pixels' centres."""

    width: int
    height: int
    start: wp.vec2
    """Those of the first pixel."""
    step: wp.vec2


@wp.func_native("""
const float* __restrict from = source.data;
float* __restrict to = target.data;
for (int i = low; i < high; ++i) to[i] += weight * (from[i + one] + from[i + other]);
""")
def _add_two(
    low: int,
    high: int,
    one: int,
    other: int,
    weight: float,
    source: wp.array(dtype=wp.float32),
    target: wp.array(dtype=wp.float32),
):
    """Add what two neighbours, at offsets `one` and `other`, hold to the pixels from `low` to before `high`."""


@wp.func
def _mirrored(index: int, size: int):
    """Index of the pixel that stands for one beyond the image's border."""
    folded = index
    while folded < 0 or folded >= size:
        folded = wp.where(folded < 0, -1 - folded, 2 * size - 1 - folded)
    return folded


@wp.kernel
def spread_along_rows(
    first: int,
    last: int,
    run: int,
    source: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    width: int,
    target: wp.array(dtype=wp.float32),
):
    """Blur an image along x with one half of a symmetric filter; mirrored at the borders, it loses no electron."""
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    for i in range(start, stop):
        target[i] = weights[0] * source[i]
    for y in range(start // width, (stop + width - 1) // width):
        row = y * width
        x0 = wp.max(start - row, 0)
        x1 = wp.min(stop - row, width)
        for k in range(1, weights.shape[0]):
            low = wp.clamp(k, x0, x1)
            high = wp.clamp(width - k, low, x1)
            for x in range(x0, low):
                _add_two(
                    row + x, row + x + 1, _mirrored(x - k, width) - x, _mirrored(x + k, width) - x, weights[k], source, target
                )
            _add_two(row + low, row + high, -k, k, weights[k], source, target)
            for x in range(high, x1):
                _add_two(
                    row + x, row + x + 1, _mirrored(x - k, width) - x, _mirrored(x + k, width) - x, weights[k], source, target
                )


@wp.kernel
def spread_along_columns(
    first: int,
    last: int,
    run: int,
    source: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    target: wp.array(dtype=wp.float32),
):
    """Blur an image along y, as `spread_along_rows` does along x."""
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    for i in range(start, stop):
        target[i] = weights[0] * source[i]
    for y in range(start // width, (stop + width - 1) // width):
        low = wp.max(start, y * width)
        high = wp.min(stop, (y + 1) * width)
        for k in range(1, weights.shape[0]):
            above = (_mirrored(y - k, height) - y) * width
            below = (_mirrored(y + k, height) - y) * width
            _add_two(low, high, above, below, weights[k], source, target)


@wp.kernel
def find_layers(
    first: int,
    last: int,
    run: int,
    depth: wp.array(dtype=wp.float32),
    object_id: wp.array(dtype=wp.uint8),
    irradiance: wp.array(dtype=wp.float32),
    layer: wp.array(dtype=wp.float32),
    distance: wp.array(dtype=wp.float32),
    left: wp.array(dtype=wp.float32),
):
    """Prepare the spreads: depths on which light cannot get from one object to another, depths without NaN, and the sum.

    Objects of different classes are put metres apart.
    """
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        left[i] = 0.0
        if object_id[i] != wp.uint8(0):
            layer[i] = depth[i] + _LAYER_M * float(object_id[i])
            distance[i] = depth[i]
        else:
            layer[i] = _FAR_LAYER_M
            distance[i] = 1.0


@wp.func_native("""
int most = 0;
for (int i = low; i < high; ++i) {
    const int taps = (int)(reach / distance.data[i]);
    most = taps > most ? taps : most;
}
return most;
""")
def _most_taps(low: int, high: int, reach: float, distance: wp.array(dtype=wp.float32)) -> int:
    """Largest quotient of `reach` and a distance, rounded down."""


@wp.func_native("""
const float* __restrict from = source.data;
const float* __restrict lay = layer.data;
const float* __restrict z = distance.data;
const float* __restrict s = scale.data;
float* __restrict to = target.data;
float* __restrict sum = total.data;
for (int i = low; i < high; ++i) {
    const float k = (float)(i - low);
    const float u = u0 + k * u_step;
    const float v = v0 + k * v_step;
    const float dz = lay[i + offset] - lay[i];
    const float du = dz * u + z[i] * shift;
    const float dv = dz * v;
    float w = 1.0f - s[i] * (du * du + dv * dv + dz * dz);
    w = w > 0.0f ? w : 0.0f;
    w *= w;
    w *= w;
    to[i] += w * from[i + offset];
    sum[i] += w;
}
""")
def _add_neighbour(
    low: int,
    high: int,
    offset: int,
    shift: float,
    u0: float,
    u_step: float,
    v0: float,
    v_step: float,
    layer: wp.array(dtype=wp.float32),
    distance: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    source: wp.array(dtype=wp.float32),
    target: wp.array(dtype=wp.float32),
    total: wp.array(dtype=wp.float32),
):
    """Add one neighbour's light to the pixels of a row from `low` to before `high`, and its weight to the total.

    Pixel and neighbour are (u, v, 1) z and (u + shift, v, 1) (z + dz): their distance squared is that of
    (dz u' + z shift, dz v, dz) with u' = u + shift. The weight is (1 - distance² / (11 sigma²))^4: a Gaussian's variance and,
    to 1 %, its transfer of what the stripes contain, but with an end and without an exponential.
    """


@wp.kernel
def diffuse(
    first: int,
    last: int,
    run: int,
    gaussians: wp.array(dtype=wp.vec2),
    reach: float,
    stride: int,
    along_x: bool,
    pixels: Pixels,
    object_id: wp.array(dtype=wp.uint8),
    layer: wp.array(dtype=wp.float32),
    distance: wp.array(dtype=wp.float32),
    source: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    total: wp.array(dtype=wp.float32),
    target: wp.array(dtype=wp.float32),
):
    """Spread irradiance along one axis of the image by the distance on the surface, with weights that add up to 1.

    Args:
        gaussians: Weight and standard deviation in metres of each object class.
        reach: Distance, in metres at the depth of 1 m, times pixels per stride, at which the widest ends.
        stride: Pixels between neighbours; several where the source is smooth.
        scale: Scratch.
        total: Scratch.
    """
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    taps = _most_taps(start, stop, reach, distance)
    for i in range(start, stop):
        sigma = gaussians[int(object_id[i])][1]
        scale[i] = wp.where(sigma > 0.0, 1.0 / (11.0 * sigma * sigma), _NO_SPREAD)
        target[i] = source[i]
        total[i] = 1.0
    width = pixels.width
    for y in range(start // width, (stop + width - 1) // width):
        row = y * width
        x0 = wp.max(start - row, 0)
        x1 = wp.min(stop - row, width)
        v = pixels.start[1] + float(y) * pixels.step[1]
        for k in range(2 * taps):
            # 1, -1, 2, -2, ...
            d = stride * (k // 2 + 1) * (1 - 2 * (k % 2))
            if along_x:
                low = wp.clamp(-d, x0, x1)
                high = wp.clamp(width - d, low, x1)
                shift = float(d) * pixels.step[0]
                u = pixels.start[0] + float(low) * pixels.step[0] + shift
                _add_neighbour(
                    row + low, row + high, d, shift, u, pixels.step[0], v, 0.0, layer, distance, scale, source, target, total
                )
            elif y + d >= 0 and y + d < pixels.height:
                shift = float(d) * pixels.step[1]
                u = pixels.start[0] + float(x0) * pixels.step[0]
                _add_neighbour(
                    row + x0, row + x1, d * width, shift, v + shift, 0.0, u, pixels.step[0], layer, distance, scale, source, target,
                    total,
                )  # fmt: skip
    for i in range(start, stop):
        target[i] = target[i] / total[i]


@wp.kernel
def add_spread(
    first: int,
    last: int,
    run: int,
    gaussians: wp.array(dtype=wp.vec2),
    object_id: wp.array(dtype=wp.uint8),
    irradiance: wp.array(dtype=wp.float32),
    left: wp.array(dtype=wp.float32),
):
    """Add the light that one Gaussian of each object class has spread, by its weight."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        left[i] += gaussians[int(object_id[i])][0] * irradiance[i]
