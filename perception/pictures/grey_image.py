"""Grey pictures from files, 8 to 16 bits a pixel, and nothing that only looks like one."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.estimators.base import to_eight_bits

SUFFIXES = (".png", ".tif", ".tiff")
_MODES = frozenset({"L", "I;16", "I;16B", "I;16L", "LA", "P", "RGB", "RGBA"})
"""Pillow's names of 8 and 16 bits a channel."""
_LEVELS_OF_12_BITS = 4096


def list_pictures(folder: Path | str) -> list[Path]:
    """Return the PNG and TIFF files of a folder by name; hidden files do not count.

    Raises:
        MissingFileError: If there is no such folder.
        InvalidValueError: If it has no picture, or two that differ in their suffix alone.
    """
    try:
        root = Path(folder).expanduser()
        found = sorted(path for path in root.iterdir() if path.suffix.lower() in SUFFIXES and path.name[0] != ".")
    except (OSError, RuntimeError) as error:
        raise MissingFileError("folder of images", folder, f"give one with {', '.join(SUFFIXES)} files") from error
    if not found:
        raise InvalidValueError("number of images in " + str(folder), 0, f"1 or more, {', '.join(SUFFIXES)}")
    stems = [path.stem for path in found]
    if twice := sorted({stem for stem in stems if stems.count(stem) > 1}):
        raise InvalidValueError(f"images in {folder}", twice, "names that differ in more than their suffix")
    return found


def read_grey(path: Path, size: tuple[int, int], *, bits: int | None = None) -> NDArray[np.uint8]:
    """Read a grey picture and round it to 8 bits, as `to_eight_bits` does.

    A picture with three channels counts as grey where all three are alike; an alpha channel must be opaque.

    Args:
        path: A PNG or TIFF file with one picture of 8 or 16 bits a channel.
        size: (height, width) that it must have.
        bits: Of the camera that wrote files of 16 bits, 9 to 16; 16 if None. Files of 8 bits are taken as they are.

    Raises:
        MissingFileError: If there is no such file.
        InvalidValueError: If it is not such a picture, has another size or a colour, or a grey value exceeds `bits`.
    """
    return _in_eight_bits(path, _grey_values(path, size), bits)


def check_pictures(paths: Sequence[Path], size: tuple[int, int], *, bits: int | None = None) -> None:
    """Read all pictures once, so that a bad one is reported before any work; raises as `read_grey` does.

    Files of 16 bits without a grey value of 4096 or more are refused unless `bits` is given: those of a camera of 10 or 12 bits
    would be read as nearly black. One of 14 bits cannot be told from a dark picture of 16.
    """
    brightest = 0
    for path in paths:
        grey = _grey_values(path, size)
        _in_eight_bits(path, grey, bits)
        if grey.dtype == np.uint16:
            brightest = max(brightest, int(grey.max()))
    if bits is None and 0 < brightest < _LEVELS_OF_12_BITS:
        allowed = f"{_LEVELS_OF_12_BITS} or more, or the camera's bits: --bits 12 if it has 12, --bits 16 if they are that dark"
        raise InvalidValueError("brightest grey value of the pictures of 16 bits", brightest, allowed)


def _grey_values(path: Path, size: tuple[int, int]) -> NDArray[Any]:
    """Return the grey values of a file, of 8 or 16 bits."""
    content = _checked_content(path, size)
    values = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise InvalidValueError("image", str(path), "a PNG or TIFF of 8 or 16 bits that can be read")
    return np.ascontiguousarray(_one_channel(path, values))


def _in_eight_bits(path: Path, grey: NDArray[Any], bits: int | None) -> NDArray[np.uint8]:
    if grey.dtype == np.uint8:
        return grey
    try:
        return to_eight_bits(grey, 16 if bits is None else bits)
    except InvalidValueError as error:
        raise error.at(str(path), ": ") from error


def _checked_content(path: Path, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the bytes of a picture that Pillow reads to the end: OpenCV fills a truncated one up with black."""
    from PIL import Image, UnidentifiedImageError  # comes with matplotlib

    if not path.is_file():
        raise MissingFileError("image", path, f"give {', '.join(SUFFIXES)} files")
    try:
        with warnings.catch_warnings():
            # What Pillow warns of is refused here, or harmless.
            warnings.simplefilter("ignore")
            with Image.open(path, formats=["PNG", "TIFF"]) as image:
                _check_header(path, image, size)
                image.load()
        return np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except InvalidValueError:
        raise
    except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split())
        raise InvalidValueError("image", str(path), f"a whole PNG or TIFF ({reason})") from error


def _check_header(path: Path, image: Any, size: tuple[int, int]) -> None:
    if (image.height, image.width) != size:
        found, wanted = f"{image.width} x {image.height}", f"{size[1]} x {size[0]}, as calibrated"
        raise InvalidValueError(f"size of image {path}", found, wanted)
    if image.mode not in _MODES:
        raise InvalidValueError(f"pixels of image {path}", image.mode, "grey values of 8 to 16 bits (L or I;16)")
    if (frames := getattr(image, "n_frames", 1)) > 1:
        raise InvalidValueError(f"pictures in {path}", frames, "1 a file")


def _one_channel(path: Path, values: NDArray[Any]) -> NDArray[Any]:
    if values.ndim == 2:
        return values
    channels = values.shape[-1]
    if channels in {2, 4} and values[..., -1].min() < np.iinfo(values.dtype).max:
        raise InvalidValueError("image", str(path), "an opaque picture; it has transparent pixels")
    colours = values[..., :1] if channels == 2 else values[..., :3]
    if (colours != colours[..., :1]).any():
        spread = int(np.ptp(colours.astype(np.int32), axis=-1).max())
        allowed = "0: a grey picture, or a colour one whose three channels are alike"
        raise InvalidValueError(f"largest difference between the channels of {path}", spread, allowed)
    grey: NDArray[Any] = colours[..., 0]
    return grey
