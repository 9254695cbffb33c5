"""What stores of pairs have in common: a calibration, points of the reference camera, and a description of each pair."""

import json
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.calibration.results import StereoCalibration
from laploop.perception.data.dataset import ReferencedDataset
from laploop.perception.data.store import Store
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion, ReprojectedDepth, reproject

Float32 = NDArray[np.float32]

CALIBRATION = "calibration.json"
METADATA_BYTES = 16384


class CalibratedPairStore(Store, ReferencedDataset):
    """Stripe frames paired with points of a reference camera, on disk; `calibration.json` lies beside the arrays."""

    NOUN = "pair"

    calibration: StereoCalibration
    """What the reference depth was reprojected with."""
    _rig: Rig

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        """Open a store; see `Store`."""
        super().__init__(path, writable=writable)

    def rig(self, index: int) -> Rig:
        """Return the rig of a pair: one scope took them all."""
        self._check_index(index)
        return self._rig

    @abstractmethod
    def reference_cloud_mm(self, index: int) -> Float32:
        """Return the reference camera's valid points (n, 3) in its frame."""

    def reproject_with(self, index: int, scope_from_reference: NDArray[np.float64]) -> ReprojectedDepth:
        """Reproject the reference camera's points into the calibrated scope's image with a given transform (4x4, metres)."""
        return reproject_by(self.calibration, self.reference_cloud_mm(index), scope_from_reference)

    def metadata(self, index: int) -> dict[str, Any]:
        """Read the metadata of a pair."""
        return cast("dict[str, Any]", json.loads(self.read("metadata", index).tobytes().rstrip(b"\0")))


def pack_metadata(index: int, metadata: Mapping[str, object]) -> NDArray[np.uint8]:
    """Return the metadata of a pair as UTF-8 JSON, zeros behind it.

    Raises:
        InvalidValueError: If they are too long or not JSON.
    """
    try:
        text = json.dumps(metadata, allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise InvalidValueError(f"metadata of pair {index}", dict(metadata), f"what JSON knows ({error})") from error
    if len(text) > METADATA_BYTES:
        raise InvalidValueError(f"length of the metadata of pair {index}", len(text), f"at most {METADATA_BYTES} bytes")
    return np.frombuffer(text.ljust(METADATA_BYTES, b"\0"), dtype=np.uint8)


def reproject_by(
    calibration: StereoCalibration, xyz_mm: Float32, scope_from_reference: NDArray[np.float64] | None = None
) -> ReprojectedDepth:
    """Reproject points (..., 3) of the reference camera with a calibration, or with another transform in place of its own."""
    transform = calibration.scope_from_reference if scope_from_reference is None else scope_from_reference
    scope = calibration.scope
    distortion = None if scope.distortion == BrownDistortion() else scope.distortion
    return reproject(xyz_mm, transform, scope.intrinsics, distortion)
