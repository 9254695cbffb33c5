"""Point clouds of depth cameras from files."""

import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, check_file

Unit = Literal["mm", "m"]
"""What the coordinates of a file are in, which no format says."""

_MM = {"mm": 1.0, "m": 1e3}
_SUFFIXES = (".ply", ".npz")


def read_cloud(path: Path, unit: Unit) -> NDArray[np.float32]:
    """Read the points of a cloud, (n, 3) in millimetres; those that are not finite, or all zero, are left out.

    A PLY file holds them as vertices, binary or text; an NPZ file as an array `xyz`, (..., 3). Depth cameras write NaN, and
    some of them zeros, where they see nothing.

    Raises:
        MissingFileError: If there is no such file.
        InvalidValueError: If it is no such file, or has no point.
    """
    path = check_file("point cloud", path, "give a .ply or .npz file")
    if path.suffix.lower() not in _SUFFIXES:
        raise InvalidValueError("point cloud", str(path), f"one of {', '.join(_SUFFIXES)}")
    try:
        values = _read_npz(path) if path.suffix.lower() == ".npz" else _read_ply(path)
    except InvalidValueError:
        raise
    # Readers of damaged files raise whatever they stumble over.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InvalidValueError("point cloud", str(path), f"a PLY or NPZ file that can be read ({reason})") from error
    if values.ndim < 2 or values.shape[-1] != 3 or values.dtype.kind not in "fiu":
        raise InvalidValueError(f"points of {path}", f"{values.dtype}, shape {values.shape}", "numbers (..., 3)")
    points = values.reshape(-1, 3).astype(np.float64)
    points = points[np.isfinite(points).all(axis=-1) & (points != 0.0).any(axis=-1)]
    if not len(points):
        raise InvalidValueError(f"number of points of {path}", 0, "1 or more that are finite and not zero")
    return np.asarray(_MM[unit] * points, dtype=np.float32)


def _read_npz(path: Path) -> NDArray[Any]:
    if not zipfile.is_zipfile(path):
        raise InvalidValueError("point cloud", str(path), "an NPZ file, as numpy.savez writes it")
    with np.load(path, allow_pickle=False) as arrays:
        if "xyz" not in arrays:
            raise InvalidValueError(f"arrays of {path}", list(arrays), "among them xyz, (..., 3)")
        values: NDArray[Any] = arrays["xyz"]
    return values


def _read_ply(path: Path) -> NDArray[Any]:
    from trimesh import load  # slow to import

    if not path.read_bytes()[:4].startswith(b"ply"):
        raise InvalidValueError("point cloud", str(path), "a PLY file, which begins with ply")
    reader: Any = load
    # Unprocessed: nothing is merged, ordered or taken away.
    found = reader(path, file_type="ply", process=False)
    return np.asarray(found.vertices)
