"""Tetrahedra kept in the user's cache folder, so that one surface always gives the same bits."""

import hashlib
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Solid = tuple[NDArray[np.float64], NDArray[np.int32]]
"""Points (n, 3) and tetrahedra (m, 4)."""


def stored_solid(surface: Solid, recipe: str, make: Callable[[], Solid]) -> Solid:
    """Return the kept solid of this surface and recipe, or make and keep it.

    Meshers draw random numbers that cannot be seeded. If two processes make the same solid at once, both return the one that
    was kept first. Where the folder cannot be written, the solid is made anew each time.

    Args:
        surface: Points (n, 3) and triangles (m, 3).
        recipe: Name, version and settings of the mesher.
        make: Makes the solid.
    """
    digest = hashlib.sha256(recipe.encode())
    for array in surface:
        digest.update(f"{array.dtype} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    path = cache_folder() / f"{digest.hexdigest()}.npz"
    kept = _load(path)
    if kept is not None:
        return kept
    solid = make()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            partial = Path(folder) / path.name
            np.savez(partial, points=solid[0], tetrahedra=solid[1])
            if path.exists() and _load(path) is None:
                path.unlink()
            # Fails if another process was first, which a rename would not.
            os.link(partial, path)
    except OSError:
        return _load(path) or solid
    return solid


def cache_folder() -> Path:
    """Return the folder of kept solids: `laploop/solids` in `$XDG_CACHE_HOME`, or in `~/.cache`."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "laploop" / "solids"


def _load(path: Path) -> Solid | None:
    try:
        with np.load(path, allow_pickle=False) as stored:
            return np.asarray(stored["points"], dtype=np.float64), np.asarray(stored["tetrahedra"], dtype=np.int32)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
