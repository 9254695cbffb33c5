"""Data sets of a bench's own pictures and reference clouds, laid out on disk as in `store`.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | the scope's grey values, undistorted |
| `reference_depth_mm` | (N, H, W) float32 | the reference camera's points, reprojected by the calibration; NaN elsewhere |
| `reference_xyz_mm` | (N, P, 3) float32 | those points in the reference camera's frame, NaN behind a pair's last |
| `metadata` | (N, 16384) uint8 | JSON of the pair, UTF-8, zeros behind it |

Nobody knows the exact depth of a real scene: there is none here, and no mask of what the projector reaches. Beside the arrays
lies `calibration.json`, of a scope without distortion, which the rig and `reference_depth_mm` come from.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import to_plain
from laploop.errors import InvalidValueError
from laploop.perception.calibration.calibration_file import CalibrationRecord, as_json, load_record
from laploop.perception.calibration.results import StereoCalibration
from laploop.perception.calibration.scope_rig import optics_of, rig_of
from laploop.perception.data.calibrated_pair_store import (
    CALIBRATION,
    METADATA_BYTES,
    CalibratedPairStore,
    Float32,
    pack_metadata,
)
from laploop.perception.data.integrity import refusing_damage

_ARRAYS = {"image": "uint8", "reference_depth_mm": "float32", "reference_xyz_mm": "float32", "metadata": "uint8"}


class ImportedPairStore(CalibratedPairStore):
    """One paired data set of a real bench on disk."""

    FORMAT = "laploop-imported-pairs-1"
    OLDER_FORMATS = ()
    COMMAND = "`laploop import-pairs`"
    has_exact = False

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        """Open a store; see `Store`."""
        super().__init__(path, writable=writable)
        with refusing_damage(f"data set {path}"):
            record = load_record(path / CALIBRATION)
            self.calibration = _stereo(record)
            self._rig = rig_of(record, path / CALIBRATION).rig

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        record: CalibrationRecord,
        points: int,
        tissue_seed: NDArray[np.int64],
        split: NDArray[np.uint8],
        tool_in_view: NDArray[np.bool_],
        config: Mapping[str, object],
    ) -> "ImportedPairStore":
        """Make an empty store for the planned pairs at a path that does not exist yet; it appears whole or not at all.

        Args:
            path: The new folder.
            record: The calibration, of a lens without distortion, with projector and reference camera.
            points: Most points of a pair, P.
            tissue_seed: Scene of each pair, (N,).
            split: Split of each pair, an index into `SPLITS`.
            tool_in_view: Pairs with an instrument in view.
            config: What the pairs were made from, as JSON has it.

        Raises:
            OutputError: If the path exists or cannot be written.
            InvalidValueError: If the calibration lacks a part, or its camera cannot be that of a scope.
        """
        optics, stereo = optics_of(record, path), _stereo(record)
        size = (optics.height, optics.width)
        shapes = {"reference_xyz_mm": (points, 3), "metadata": (METADATA_BYTES,)}
        calibration = as_json(stereo, projector=record.projector, mask=record.mask or StripeMask())
        return cls._create(
            path,
            arrays={name: (dtype, shapes.get(name, size)) for name, dtype in _ARRAYS.items()},
            plan={"tissue_seed": tissue_seed, "split": split, "tool_in_view": tool_in_view},
            files={CALIBRATION: calibration.encode()},
            optics=to_plain(optics),
            config=dict(config),
        )

    def write(
        self,
        index: int,
        *,
        image: NDArray[np.uint8],
        reference_depth_mm: Float32,
        reference_xyz_mm: Float32,
        metadata: Mapping[str, object],
    ) -> None:
        """Write one pair, which is done when this returns; `reference_xyz_mm` are its points (n, 3), P at most.

        Raises:
            InvalidValueError: If there is no such pair, an array has another type or shape, or the metadata are too long.
            OutputError: If the disk refuses.
        """
        padded = np.full(self._arrays["reference_xyz_mm"].shape[1:], np.nan, dtype=np.float32)
        if not len(reference_xyz_mm) <= len(padded):
            raise InvalidValueError(f"points of pair {index}", len(reference_xyz_mm), f"at most {len(padded)}")
        padded[: len(reference_xyz_mm)] = reference_xyz_mm
        arrays: dict[str, NDArray[Any]] = {"image": image, "reference_depth_mm": reference_depth_mm}
        arrays |= {"reference_xyz_mm": padded, "metadata": pack_metadata(index, metadata)}
        self._write(index, arrays)

    def reference_cloud_mm(self, index: int) -> Float32:
        """Return the reference camera's points (n, 3) in its frame."""
        xyz_mm: Float32 = self.read("reference_xyz_mm", index)
        return xyz_mm[np.isfinite(xyz_mm).all(axis=-1)]

    def depth_mm(self, index: int) -> NoReturn:
        """Refuse: see the module."""
        self._check_index(index)
        raise InvalidValueError(f"exact depth of {self.path}", None, "that of the reference camera: the pairs are real")

    def lit(self, index: int) -> NoReturn:
        """Refuse: see the module."""
        self._check_index(index)
        raise InvalidValueError(f"mask of the lit pixels of {self.path}", None, "none: the pairs are real")


def _stereo(record: CalibrationRecord) -> StereoCalibration:
    if record.stereo is None:
        raise InvalidValueError("calibration", "without a reference camera", "one with cameras.reference and transforms")
    return record.stereo
