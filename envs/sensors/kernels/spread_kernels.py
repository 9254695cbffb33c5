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
    counts: wp.array(dtype=wp.int32),
    width: int,
    target: wp.array(dtype=wp.float32),
):
    """Blur an image along x with one half of a symmetric filter, the first `counts[0]` weights.

    Mirrored at the borders, it loses no electron.
    """
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    for i in range(start, stop):
        target[i] = weights[0] * source[i]
    for y in range(start // width, (stop + width - 1) // width):
        row = y * width
        x0 = wp.max(start - row, 0)
        x1 = wp.min(stop - row, width)
        for k in range(1, counts[0]):
            low = wp.clamp(k, x0, x1)
            high = wp.clamp(width - k, low, x1)
            for x in range(x0, low):
                one = _mirrored(x - k, width) - x
                other = _mirrored(x + k, width) - x
                _add_two(row + x, row + x + 1, one, other, weights[k], source, target)
            _add_two(row + low, row + high, -k, k, weights[k], source, target)
            for x in range(high, x1):
                one = _mirrored(x - k, width) - x
                other = _mirrored(x + k, width) - x
                _add_two(row + x, row + x + 1, one, other, weights[k], source, target)


@wp.kernel
def spread_along_columns(
    first: int,
    last: int,
    run: int,
    source: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    counts: wp.array(dtype=wp.int32),
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
        for k in range(1, counts[0]):
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
#pragma clang loop vectorize(assume_safety)
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
#pragma clang loop vectorize(assume_safety)
for (int i = low; i < high; ++i) {
    const float k = (float)(i - low);
    const float u = along[0] + k * along[1];
    const float v = aside[0] + k * aside[1];
    const float dz = lay[i + offset] - lay[i];
    const float du = dz * u + z[i] * shift;
    const float dv = dz * v;
    float w = 1.0f - s[i] * (du * du + dv * dv + dz * dz);
    w = w > 0.82f ? w : 0.0f;
    w *= w;
    w *= w;
    w *= w;
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
    along: wp.vec2,
    aside: wp.vec2,
    layer: wp.array(dtype=wp.float32),
    distance: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    source: wp.array(dtype=wp.float32),
    target: wp.array(dtype=wp.float32),
    total: wp.array(dtype=wp.float32),
):
    """Add one neighbour's light to the pixels of a row from `low` to before `high`, and its weight to the total.

    Pixel and neighbour are (u - shift, v, 1) z and (u, v, 1) (z + dz), which are (dz u + z shift, dz v, dz) apart; `along` and
    `aside` are u and v at `low` and their steps. The weight is (1 - distance² / (67 sigma²))^32, which has the Gaussian's
    variance and all but its shape; it is cut off after 3.5 sigma, where 1 - distance² / (67 sigma²) is 0.82.
    """


@wp.kernel
def diffuse(
    first: int,
    last: int,
    run: int,
    number: int,
    gaussians: wp.array2d(dtype=wp.vec2),
    spreads: wp.array2d(dtype=wp.vec2),
    axis: int,
    pixels: Pixels,
    object_id: wp.array(dtype=wp.uint8),
    layer: wp.array(dtype=wp.float32),
    distance: wp.array(dtype=wp.float32),
    source: wp.array(dtype=wp.float32),
    scale: wp.array(dtype=wp.float32),
    total: wp.array(dtype=wp.float32),
    target: wp.array(dtype=wp.float32),
):
    """Spread irradiance along x (`axis` 0) or y (1) by the distance on the surface, with weights that add up to 1.

    `gaussians[number]` has weight and standard deviation in metres of each object class. `spreads[number]` says along each axis
    where the widest material's weights end, as distance over depth in steps of a stride, and that stride in pixels, which is
    several where the source is smooth. `scale` and `total` are scratch.
    """
    spread = spreads[number, axis]
    stride = int(spread[1])
    start = first + wp.tid() * run
    stop = wp.min(start + run, last)
    taps = _most_taps(start, stop, spread[0], distance)
    for i in range(start, stop):
        sigma = gaussians[number, int(object_id[i])][1]
        scale[i] = wp.where(sigma > 0.0, 1.0 / (67.0 * sigma * sigma), _NO_SPREAD)
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
            low = int(x0)
            high = int(x1)
            offset = int(d)
            if axis == 0:
                low = wp.clamp(-d, x0, x1)
                high = wp.clamp(width - d, low, x1)
            else:
                offset = d * width
                if y + d < 0 or y + d >= pixels.height:
                    high = low
            shift = float(d) * pixels.step[axis]
            across = wp.vec2(pixels.start[0] + float(low) * pixels.step[0], pixels.step[0])
            down = wp.vec2(v, 0.0)
            along = wp.where(axis == 0, across, down) + wp.vec2(shift, 0.0)
            aside = wp.where(axis == 0, down, across)
            _add_neighbour(row + low, row + high, offset, shift, along, aside, layer, distance, scale, source, target, total)
    for i in range(start, stop):
        target[i] = target[i] / total[i]


@wp.kernel
def add_spread(
    first: int,
    last: int,
    run: int,
    number: int,
    gaussians: wp.array2d(dtype=wp.vec2),
    object_id: wp.array(dtype=wp.uint8),
    irradiance: wp.array(dtype=wp.float32),
    left: wp.array(dtype=wp.float32),
):
    """Add the light that one Gaussian of each object class has spread, by its weight."""
    start = first + wp.tid() * run
    for i in range(start, wp.min(start + run, last)):
        left[i] += gaussians[number, int(object_id[i])][0] * irradiance[i]
