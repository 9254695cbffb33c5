"""Makes a data set of a bench's own pictures and reference clouds, which training and evaluation take.

The reference depth is made as in the paper (`perception/reprojection.py`): points of the reference camera, moved by the
calibrated transform, projected with the calibrated intrinsics, the nearest at each pixel.
"""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.calibration.calibration_file import CalibrationRecord, load_record
from laploop.perception.calibration.scope_rig import optics_of
from laploop.perception.data.calibrated_pair_store import reproject_by
from laploop.perception.data.imported_pair_store import ImportedPairStore
from laploop.perception.data.pair_list import LIST, PairList
from laploop.perception.data.point_cloud import Unit, read_cloud
from laploop.perception.geometry import transform_points
from laploop.perception.pictures.grey_image import check_pictures, read_grey
from laploop.perception.pictures.undistortion import Undistortion
from laploop.perception.reprojection import BrownDistortion

_MARGIN = 0.1
"""Points are kept up to this fraction of the image beyond its borders, so that they can be reprojected by another transform."""
_PLAUSIBLE_MM = (5.0, 2000.0)
"""Median distance from the scope of the points that it sees; metres taken for millimetres lie outside, and the reverse."""

Report = Callable[[int], None]


@configuration
class PairImport:
    """Pictures and clouds of a bench, and how to read them."""

    folder: Path
    """Folder with pairs.csv and the files that it lists."""
    calibration: Path
    """A calibration.json with scope, projector, reference camera and scope_from_reference."""
    unit: Unit
    """What the clouds' coordinates are in."""
    bits: Annotated[int, Field(ge=9, le=16)] | None = None
    """Bits a pixel of the camera that wrote pictures of 16 bits; by default 16, to be given where all end below 4096."""


class PairImporter:
    """One import, checked as a whole before anything is written."""

    def __init__(self, config: PairImport) -> None:
        """Read calibration and list.

        Raises:
            MissingFileError: If a file is not there.
            InvalidValueError: If the calibration or the list is not valid, or one of them lacks a part.
        """
        record = load_record(config.calibration)
        optics_of(record, config.calibration)
        if record.stereo is None:
            allowed = "one with cameras.reference and transforms.scope_from_reference"
            raise InvalidValueError("calibration", str(config.calibration), allowed)
        if record.mask is not None and record.mask.is_drawn:
            raise InvalidValueError("mask of the calibration", str(config.calibration), "stripes; networks read no drawn mask")
        self.config = config
        self.list = PairList.read(config.folder)
        self._undistortion = Undistortion(record.scope)
        pinhole = replace(record.scope, distortion=BrownDistortion())
        self._stereo = replace(record.stereo, scope=pinhole)
        self._record: CalibrationRecord = replace(record, scope=pinhole, stereo=self._stereo)
        self._points: list[int] = []

    def __len__(self) -> int:
        return len(self.list.pairs)

    def check(self, report: Report | None = None) -> None:
        """Read all pictures and clouds once, which must fit the calibration; `report` is called with the number read.

        Raises:
            MissingFileError: If a file is not there.
            InvalidValueError: If one cannot be read, has another size, or no point is seen by the scope; it is named.
        """
        self._points = []
        check_pictures([pair.image for pair in self.list.pairs], self._size, bits=self.config.bits)
        for number in range(len(self)):
            self._points.append(len(self._cloud(number)))
            if report is not None:
                report(number + 1)

    def write(self, path: Path, report: Report | None = None) -> ImportedPairStore:
        """Write the data set, or the pairs that an interrupted import of the same files left out.

        Raises:
            OutputError: If `path` holds other data or cannot be written.
        """
        store = self._open_or_create(path)
        done = store.done()
        for number in range(len(self)):
            if not done[number]:
                cloud, pair = self._cloud(number), self.list.pairs[number]
                store.write(
                    number,
                    image=self._undistortion.apply(self._image(number)),
                    reference_depth_mm=reproject_by(self._stereo, cloud).depth_mm,
                    reference_xyz_mm=cloud,
                    metadata={
                        "index": number,
                        "image": pair.image.name,
                        "cloud": pair.cloud.name,
                        "scene": pair.scene,
                    },
                )
            if report is not None:
                report(number + 1)
        return store

    def _open_or_create(self, path: Path) -> ImportedPairStore:
        recipe = {
            "unit": self.config.unit,
            "bits": self.config.bits,
            "calibration_sha256": _sha256(self.config.calibration),
            "list_sha256": _sha256(self.config.folder / LIST),
            "points": self._points,
            "scenes": list(self.list.scenes),
        }
        if path.exists():
            store = ImportedPairStore.open(path, writable=True)
            if store.config != recipe:
                raise OutputError(f"{path} holds an import of other files or options; give a new folder")
            store.remove_left_behind()
            return store
        return ImportedPairStore.create(
            path,
            record=self._record,
            points=max(self._points),
            tissue_seed=self.list.scene_number,
            split=self.list.split,
            tool_in_view=self.list.tool_in_view,
            config=recipe,
        )

    @property
    def _size(self) -> tuple[int, int]:
        camera = self._record.scope.intrinsics
        return camera.height, camera.width

    def _image(self, number: int) -> NDArray[np.uint8]:
        return read_grey(self.list.pairs[number].image, self._size, bits=self.config.bits)

    def _cloud(self, number: int) -> NDArray[np.float32]:
        """Return the points of a pair that the scope sees, or that lie close to its view."""
        path = self.list.pairs[number].cloud
        points = read_cloud(path, self.config.unit)
        in_scope = transform_points(self._stereo.scope_from_reference, 1e-3 * points.astype(np.float64))
        ahead = in_scope[:, 2] > 0.0
        points, in_scope = points[ahead], in_scope[ahead]
        camera = self._record.scope.intrinsics
        u, v = camera.project(in_scope).T
        beyond_x, beyond_y = _MARGIN * camera.width, _MARGIN * camera.height
        near = (u >= -beyond_x) & (v >= -beyond_y) & (u < camera.width + beyond_x) & (v < camera.height + beyond_y)
        inside = (u >= 0.0) & (v >= 0.0) & (u < camera.width) & (v < camera.height)
        if not inside.any():
            allowed = f"1 or more; is the unit {self.config.unit}, and scope_from_reference in metres?"
            raise InvalidValueError(f"points of {path} in the scope's view", 0, allowed)
        median_mm = 1e3 * float(np.median(in_scope[inside, 2]))
        low, high = _PLAUSIBLE_MM
        if not low <= median_mm <= high:
            allowed = f"{low:g} to {high:g} mm; is the unit {self.config.unit}?"
            raise InvalidValueError(f"median distance of {path} from the scope", round(median_mm, 3), allowed)
        # What falls where the lens does not reach would be compared with nothing.
        near[inside] &= self._undistortion.seen[v[inside].astype(np.intp), u[inside].astype(np.intp)]
        kept: NDArray[np.float32] = points[near]
        return kept


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.expanduser().read_bytes()).hexdigest()
