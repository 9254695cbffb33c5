"""Data sets of stripe frames paired with a reference camera's captures, laid out on disk as in `store`.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | the scope's grey values |
| `reference_depth_mm` | (N, H, W) float32 | the reference camera's points, reprojected by the calibration; NaN elsewhere |
| `depth_mm` | (N, H, W) float32 | exact z-depth, NaN where nothing was hit |
| `lit`, `shadow` | (N, H, W) bool | the projector reaches the point; another surface keeps its light away |
| `projector_x`, `projector_y` | (N, H, W) float32 | exact tangent coordinates on the mask, NaN where nothing was hit |
| `reference_z_mm` | (N, h, w) float32 | the reference camera's depth map in its region of interest, NaN where invalid |
| `reference_rgba` | (N, h, w, 4) uint8 | its colour picture |
| `metadata` | (N, 16384) uint8 | JSON of the frame, UTF-8, zeros behind it |

Beside the arrays lies `calibration.json`, the calibration that `reference_depth_mm` was made with.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.configuration import to_plain
from laploop.perception.calibration.calibration_file import as_json, load_calibration
from laploop.perception.calibration.results import StereoCalibration
from laploop.perception.data.calibrated_pair_store import (
    CALIBRATION,
    METADATA_BYTES,
    CalibratedPairStore,
    Float32,
    pack_metadata,
)
from laploop.perception.data.integrity import refusing_damage
from laploop.perception.geometry import Intrinsics, Rig

Bool = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class PairFrame:
    """The arrays of one pair; shapes and units as the module says."""

    image: NDArray[np.uint8]
    reference_depth_mm: Float32
    depth_mm: Float32
    lit: Bool
    shadow: Bool
    projector_x: Float32
    projector_y: Float32
    reference_z_mm: Float32
    reference_rgba: NDArray[np.uint8]


_TYPES = {field.name: "float32" for field in fields(PairFrame)}
_TYPES |= {"image": "uint8", "lit": "bool", "shadow": "bool", "reference_rgba": "uint8"}


class PairStore(CalibratedPairStore):
    """One paired data set of the simulated bench on disk."""

    FORMAT = "laploop-pairs-2"
    OLDER_FORMATS = ("laploop-pairs-1",)
    COMMAND = "`laploop collect`"

    def __init__(self, path: Path, *, writable: bool = False) -> None:
        """Open a store; see `Store`."""
        super().__init__(path, writable=writable)
        with refusing_damage(f"data set {path}"):
            self.reference_intrinsics = Intrinsics(**self._attributes["reference_intrinsics"])
            """Of the reference camera's region of interest, as calibrated by its maker; turns `z` into `xyz`."""
            self.true_scope_from_reference: NDArray[np.float64] = np.array(self._attributes["true_scope_from_reference"])
            """4x4, metres; known to a simulator only."""
            self.calibration = load_calibration(path / CALIBRATION)
        self._rig = Rig.from_optics(self.optics)

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        optics: ScopeOptics,
        reference_intrinsics: Intrinsics,
        true_scope_from_reference: NDArray[np.float64],
        calibration: StereoCalibration,
        tissue_seed: NDArray[np.int64],
        split: NDArray[np.uint8],
        tool_in_view: Bool,
        config: Mapping[str, object],
    ) -> "PairStore":
        """Make an empty store for the planned pairs at a path that does not exist yet; it appears whole or not at all.

        Raises:
            OutputError: If the path exists or cannot be written.
        """
        scope, reference = (optics.height, optics.width), (reference_intrinsics.height, reference_intrinsics.width)
        shapes = {"reference_z_mm": reference, "reference_rgba": (*reference, 4)}
        return cls._create(
            path,
            arrays={
                **{name: (dtype, shapes.get(name, scope)) for name, dtype in _TYPES.items()},
                "metadata": ("uint8", (METADATA_BYTES,)),
            },
            plan={"tissue_seed": tissue_seed, "split": split, "tool_in_view": tool_in_view},
            files={CALIBRATION: as_json(calibration).encode()},
            optics=to_plain(optics),
            reference_intrinsics=to_plain(reference_intrinsics),
            true_scope_from_reference=true_scope_from_reference.tolist(),
            config=dict(config),
        )

    def write(self, index: int, frame: PairFrame, metadata: Mapping[str, object]) -> None:
        """Write one pair, which is done when this returns.

        Raises:
            InvalidValueError: If an array has another type or shape, or the metadata are too long or not JSON.
            OutputError: If the disk refuses.
        """
        self._write(index, {**vars(frame), "metadata": pack_metadata(index, metadata)})

    def frame(self, index: int) -> PairFrame:
        """Read all arrays of a pair."""
        return PairFrame(**{name: self.read(name, index) for name in _TYPES})

    def reference_cloud_mm(self, index: int) -> Float32:
        """Return the reference camera's valid points (n, 3) in its frame, to the bit what the camera gave."""
        z_mm: Float32 = self.read("reference_z_mm", index)
        cloud: Float32 = self.reference_intrinsics.rays.astype(np.float32) * z_mm[..., None]
        return cloud[np.isfinite(z_mm)]
