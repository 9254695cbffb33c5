"""A mask's transmission as an image in text form, for configurations: short, hashable, fit for JSON."""

import base64
import binascii
import re
import zlib

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError

LARGEST_SIDE = 1024
"""Most rows and columns of a pattern: four times the camera's pixels."""

_HEAD = re.compile(r"([0-9]{1,4})x([0-9]{1,4}):")
_ALLOWED = "ROWSxCOLUMNS: and base64 of zlib of one byte a pixel, as `encode_pattern` writes it"


def encode_pattern(transmission: NDArray[np.floating]) -> str:
    """Write a transmission from 0 to 1, (rows, columns), with 8 bits a pixel.

    Raises:
        InvalidValueError: If it is not two-dimensional, too large, or reaches beyond 0 to 1.
    """
    if transmission.ndim != 2 or not 1 <= min(transmission.shape) <= max(transmission.shape) <= LARGEST_SIDE:
        raise InvalidValueError("shape of a mask's pattern", transmission.shape, f"(rows, columns), 1 to {LARGEST_SIDE} each")
    if not ((transmission >= 0.0) & (transmission <= 1.0)).all():
        raise InvalidValueError("pattern", "an array with values below 0, above 1 or NaN", "transmissions from 0 to 1")
    grey = np.floor(transmission * 255.0 + 0.5).astype(np.uint8)
    rows, columns = grey.shape
    return f"{rows}x{columns}:{base64.b64encode(zlib.compress(grey.tobytes(), 9)).decode('ascii')}"


def decode_pattern(pattern: str) -> NDArray[np.float64]:
    """Read a transmission, (rows, columns) from 0 to 1.

    Raises:
        InvalidValueError: If the text is not what `encode_pattern` writes.
    """
    head = _HEAD.match(pattern)
    shown = pattern if len(pattern) <= 40 else pattern[:40] + "..."
    if head is None:
        raise InvalidValueError("pattern", shown, _ALLOWED)
    rows, columns = int(head[1]), int(head[2])
    if not 1 <= min(rows, columns) <= max(rows, columns) <= LARGEST_SIDE:
        raise InvalidValueError("shape of a mask's pattern", (rows, columns), f"(rows, columns), 1 to {LARGEST_SIDE} each")
    try:
        packed = base64.b64decode(pattern[head.end() :], validate=True)
        # One byte more than expected reveals a text that is too long without unpacking all of it.
        grey = zlib.decompressobj().decompress(packed, rows * columns + 1)
    except (binascii.Error, zlib.error, ValueError) as error:
        raise InvalidValueError("pattern", shown, f"{_ALLOWED} ({error})") from error
    if len(grey) != rows * columns:
        raise InvalidValueError("pattern", shown, f"{rows * columns} pixels, as in its head; found {len(grey)} or more")
    return np.frombuffer(grey, dtype=np.uint8).reshape(rows, columns) / 255.0
