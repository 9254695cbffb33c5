"""Products with matrices that are zero far from their diagonal, in blocks that leave most of the zeros out.

With Gaussians as narrow as those of the front end, this takes half the time of the whole product, or less.
"""

import math

import torch
from torch import Tensor

_BLOCKS = 4
"""More of them would leave out more zeros, but what a product costs at least would count as much."""


def cut_to_band(matrix: Tensor, reach: int) -> Tensor:
    """Leave out of a matrix (..., inputs, outputs) what is farther than `reach` inputs from a block of outputs.

    Outputs are as many as inputs, or a whole fraction of that.

    Returns:
        (..., rows, outputs). The blocks lie side by side, each with rows of its own; at the ends, some are zero.
    """
    inputs, outputs = matrix.shape[-2:]
    count = _blocks(outputs)
    rows = min(inputs, inputs // count + 2 * reach)
    columns = matrix.chunk(count, dim=-1)
    return torch.cat(
        [part.narrow(-2, start, rows) for start, part in zip(_starts(inputs, count, rows), columns, strict=True)], dim=-1
    )


def along_rows(image: Tensor, band: Tensor) -> Tensor:
    """Return the image (..., height, inputs) times the matrix that `band` was cut from: (..., height, outputs)."""
    rows, outputs = band.shape[-2:]
    count = _blocks(outputs)
    pieces = zip(_starts(image.shape[-1], count, rows), band.chunk(count, dim=-1), strict=True)
    return torch.cat([image.narrow(-1, start, rows) @ block for start, block in pieces], dim=-1)


def along_columns(image: Tensor, band: Tensor) -> Tensor:
    """Return the transpose of that matrix times the image (..., inputs, width): (..., outputs, width)."""
    rows, outputs = band.shape[-2:]
    count = _blocks(outputs)
    pieces = zip(_starts(image.shape[-2], count, rows), band.chunk(count, dim=-1), strict=True)
    return torch.cat([block.mT @ image.narrow(-2, start, rows) for start, block in pieces], dim=-2)


def _blocks(outputs: int) -> int:
    return math.gcd(_BLOCKS, outputs)


def _starts(inputs: int, count: int, rows: int) -> list[int]:
    """Return the first input of each block: as many before a block's own as behind them, where there are as many."""
    own = inputs // count
    return [min(max(number * own - (rows - own) // 2, 0), inputs - rows) for number in range(count)]
