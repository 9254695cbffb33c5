"""A user's own closed surface as the phantom: read, checked, filled with tetrahedra.

The file holds millimetres, z up; the surface is centred in x and y and its lowest point is set on the plate. trimesh (MIT)
reads it. fTetWild (Hu et al., ACM Trans. Graph. 39(4), 2020) fills it through pytetwild (MPL-2.0, an optional extra): unlike
meshers under AGPL or GPL its licence fits an Apache-2.0 project, and it remeshes any triangles to an even resolution, within
a thousandth of the body's diagonal. A surface of more than `MAX_TRIANGLES` is simplified first, within as much again.
"""

import functools
import json
import subprocess
import sys
import tempfile
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.assets.phantom_import.self_intersection import crossing_triangles
from laploop.assets.phantom_import.solid_store import Solid, stored_solid
from laploop.assets.tissue_mesh import TissueMesh, solid_from_tetrahedra
from laploop.errors import InvalidValueError, LaploopNote, check_file

SUFFIXES = (".stl", ".obj", ".ply")
MAX_TRIANGLES = 50_000
"""A surface of more is simplified to as many: they are a millimetre wide on the largest body, the tetrahedra five."""
MAX_GIVEN_TRIANGLES = 2_000_000
WIDTH_RANGE_MM = (20.0, 200.0)
"""Along x and y: at least the middle of the view, from which targets are drawn, at most the plate."""
HEIGHT_RANGE_MM = (5.0, 80.0)
"""Along z: the stage must stay above the table at the largest working distance drawn."""

_MAX_BYTES = 100 * 2**20
_EDGE_FRACTION = 0.025
"""Edges of the tetrahedra over the diagonal of the body's box: 4 mm for 110x110x28 mm, about 5 000 vertices."""
_ENVELOPE_FRACTION = 1e-3
"""Largest distance of a new surface, the mesher's or a simplified one, from the one before over that diagonal."""
_STOP_ENERGY = 50.0
"""Energy at which fTetWild stops improving: the lattice carries the mechanics, so the tetrahedra may be irregular."""
_FILLER = """
import ctypes, json, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, 9)  # killed when its parent ends
import numpy as np, pytetwild
surface = np.load("surface.npz")
solid = pytetwild.tetrahedralize(surface["points"], surface["triangles"], num_threads=1, **json.loads(sys.argv[1]))
np.savez("solid.npz", points=solid[0], tetrahedra=solid[1])
"""
_CROSSING_TOLERANCE_MM = 1e-4


def load_phantom(path: Path | str) -> TissueMesh:
    """Read a closed surface and fill it; on one machine, equal files make equal solids (`solid_store`).

    A surface of more than `MAX_TRIANGLES` triangles is simplified, and a `LaploopNote` says so.

    Args:
        path: A `.stl`, `.obj` or `.ply` file in millimetres, z up.

    Raises:
        MissingFileError: If there is no such file.
        InvalidValueError: If it cannot be read, is not one closed, oriented surface without self-intersections, has more than
            `MAX_GIVEN_TRIANGLES` triangles, cannot be simplified well enough, or is not of a size within `WIDTH_RANGE_MM` and
            `HEIGHT_RANGE_MM`; or if the extra `mesh` is not installed.
    """
    found = _existing(path).resolve()
    stat = found.stat()
    return _loaded(found, (stat.st_mtime_ns, stat.st_size))


@functools.lru_cache(maxsize=4)
def _loaded(path: Path, _stamp: tuple[int, int]) -> TissueMesh:
    """Load a phantom once while its file does not change: every reset of an environment needs it."""
    points, triangles = checked_surface(path)
    settings: dict[str, Any] = {"edge_length_fac": _EDGE_FRACTION, "epsilon": _ENVELOPE_FRACTION, "stop_energy": _STOP_ENERGY}
    recipe = f"pytetwild {version('pytetwild')} {settings}"
    vertices, tetrahedra = stored_solid((points, triangles), recipe, lambda: _fill(path, points, triangles, settings))
    return solid_from_tetrahedra(1e-3 * vertices, tetrahedra)


def _fill(path: Path, points: Array, triangles: NDArray[np.int32], settings: dict[str, Any]) -> Solid:
    """Fill a checked surface with tetrahedra; all in millimetres.

    It runs in a process and a folder of its own: fTetWild leaves a file in its working folder, and may crash on a body that
    it cannot mesh.
    """
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "surface.npz", points=points, triangles=triangles)
        command = [sys.executable, "-P", "-c", _FILLER, json.dumps(settings)]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)  # noqa: S603  our own code
        if done.returncode != 0:
            reason = (done.stderr.strip().splitlines() or [f"fTetWild ended with status {done.returncode}"])[-1]
            raise InvalidValueError(f"phantom {path.name}", reason, "a body that fTetWild can fill")
        with np.load(Path(folder) / "solid.npz") as solid:
            vertices, tetrahedra = solid["points"], solid["tetrahedra"]
    corners = vertices[tetrahedra]
    volume = float(np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6.0)
    expected = _volume(points[triangles])
    if not abs(volume - expected) < 0.03 * expected:
        raise InvalidValueError(
            f"volume of the tetrahedra that fill phantom {path.name}",
            f"{volume:.0f} mm^3",
            f"{expected:.0f} mm^3 within 3 %; walls thinner than {_EDGE_FRACTION:.1%} of the diagonal cannot be filled",
        )
    return vertices, tetrahedra.astype(np.int32)


def checked_surface(path: Path) -> tuple[Array, NDArray[np.int32]]:
    """Read and check a surface, as `load_phantom`: points (n, 3) in mm and triangles (m, 3), anticlockwise from outside."""
    surface = _read(_existing(path))
    name = f"phantom {path.name}"
    _check_size(name, *_arrays(surface))
    _check_closed(name, surface)
    if len(surface.faces) > MAX_TRIANGLES:
        surface = _simplified(name, surface)
        name = f"simplified {name}"
        _check_closed(name, surface)
    points, triangles = _arrays(surface)
    crossing = crossing_triangles(points, triangles, tolerance=_CROSSING_TOLERANCE_MM)
    if crossing is not None:
        where = points[triangles[crossing[0]]].mean(axis=0).round(1).tolist()
        raise InvalidValueError(
            name, f"self-intersecting near {where} mm", "a surface that does not cross itself; repair it first"
        )
    return points, triangles if _volume(points[triangles]) > 0.0 else triangles[:, ::-1].copy()


def _arrays(surface: Any) -> tuple[Array, NDArray[np.int32]]:
    return np.array(surface.vertices, dtype=np.float64), np.array(surface.faces, dtype=np.int32)


def _simplified(name: str, surface: Any) -> Any:
    """Return a surface of `MAX_TRIANGLES`, not farther from the given one than the mesher may go, and say what was done."""
    from laploop.assets.phantom_import.simplification import deviation, with_fewer_triangles

    simpler = with_fewer_triangles(surface, MAX_TRIANGLES)
    remedy = "simplify it first"
    if len(simpler.faces) > MAX_TRIANGLES:
        raise InvalidValueError(
            f"number of triangles of simplified {name}", len(simpler.faces), f"at most {MAX_TRIANGLES}; {remedy}"
        )
    apart, limit = deviation(surface, simpler), _ENVELOPE_FRACTION * float(surface.scale)
    if not apart <= limit:
        allowed = f"at most {limit:.2g} mm, a thousandth of its diagonal; {remedy}"
        raise InvalidValueError(f"distance of {name} from itself with {MAX_TRIANGLES} triangles", f"{apart:.2g} mm", allowed)
    message = f"{name} was simplified from {len(surface.faces)} to {len(simpler.faces)} triangles, at most {apart:.2g} mm away"
    warnings.warn(message, LaploopNote, stacklevel=2)
    return simpler


def _existing(path: Path | str) -> Path:
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InvalidValueError("suffix of the phantom's file", Path(path).suffix, " or ".join(SUFFIXES))
    return check_file("phantom", path, f"give the path of a closed surface in millimetres ({', '.join(SUFFIXES)})")


def _read(path: Path) -> Any:
    import trimesh

    try:
        # Both are needed later; if missing, better said before the long checks.
        import fast_simplification  # noqa: F401
        import pytetwild  # noqa: F401
    except ImportError as error:
        raise InvalidValueError(
            "phantom", str(path), f"none, as package {error.name!r} is missing; install it with: pip install 'laploop[mesh]'"
        ) from error
    if path.stat().st_size > _MAX_BYTES:
        raise InvalidValueError(f"size of {path}", f"{path.stat().st_size} bytes", f"at most {_MAX_BYTES}")
    try:
        with warnings.catch_warnings():
            # Of numbers that overflow, in files that are refused in any case.
            warnings.simplefilter("ignore", RuntimeWarning)
            surface = trimesh.load_mesh(path, process=True)
            surface.merge_vertices(merge_tex=True, merge_norm=True)
            surface.faces  # noqa: B018  a cloud of points has none, and should fail here
    except Exception as error:
        # Parsers raise errors of any kind.
        reason = f"{type(error).__name__}: {error}"
        raise InvalidValueError(f"phantom {path.name}", reason, f"a readable triangle mesh ({', '.join(SUFFIXES)})") from error
    return surface


def _check_size(name: str, points: Array, triangles: NDArray[np.int32]) -> None:
    if not 4 <= len(triangles) <= MAX_GIVEN_TRIANGLES:
        remedy = "; simplify it first" if len(triangles) > MAX_GIVEN_TRIANGLES else ""
        raise InvalidValueError(f"number of triangles of {name}", len(triangles), f"4 to {MAX_GIVEN_TRIANGLES}{remedy}")
    if not np.isfinite(points).all():
        raise InvalidValueError(name, "a mesh with NaN or infinity", "finite millimetres")
    size = np.ptp(points[np.unique(triangles)], axis=0)
    for axis, extent, (low, high) in zip("xyz", size, (WIDTH_RANGE_MM, WIDTH_RANGE_MM, HEIGHT_RANGE_MM), strict=True):
        if not low <= extent <= high:
            raise InvalidValueError(f"size of {name} along {axis}", f"{extent:.6g} mm", f"{low:g} to {high:g} mm (z is up)")


def _check_closed(name: str, surface: Any) -> None:
    _, uses = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    if np.any(uses != 2):
        allowed = "0: a closed surface, two triangles at every edge; fill its holes first"
        raise InvalidValueError(f"number of open or overcrowded edges of {name}", int((uses != 2).sum()), allowed)
    if not surface.is_winding_consistent:
        raise InvalidValueError(f"orientation of {name}", "mixed", "all triangles anticlockwise from outside")
    if surface.body_count != 1:
        bodies = int(surface.body_count)
        raise InvalidValueError(f"number of separate surfaces of {name}", bodies, "1: a single body without cavities")


def _volume(corners: Array) -> float:
    """Return the volume inside triangles (m, 3, 3) that are anticlockwise from outside."""
    return float(np.linalg.det(corners - corners[0, 0]).sum() / 6.0)
