"""Writes an organ as a file that a theatre takes as its phantom."""

from pathlib import Path

import numpy as np
import trimesh

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.assets.anatomy.phantom_body import phantom_body
from laploop.assets.phantom_import.phantom_mesh import SUFFIXES
from laploop.errors import InvalidValueError
from laploop.whole_file import whole_file


def write_phantom(family: str, seed: int, path: Path) -> AnatomyMesh:
    """Write the organ of a seed as a file that `load_phantom` reads, in millimetres, and return it.

    Raises:
        UnknownNameError: If there is no phantom of that family.
        InvalidValueError: If the file's suffix is not one that `load_phantom` knows, or scikit-image is not installed.
        OutputError: If the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InvalidValueError("suffix of the phantom's file", path.suffix, " or ".join(SUFFIXES))
    body = phantom_body(family, np.random.default_rng(seed))

    surface = trimesh.Trimesh(1e3 * body.points, body.triangles, process=False)
    with whole_file(path) as partial:
        surface.export(partial, file_type=suffix.removeprefix("."))
    return body
