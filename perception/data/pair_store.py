"""Data sets of stripe frames paired with a reference camera's captures: a Zarr group, a chunk a frame.

| array | shape, type | what |
|---|---|---|
| `image` | (N, H, W) uint8 | the scope's grey values |
| `reference_depth_mm` | (N, H, W) float32 | the reference camera's points as the calibration reprojects them; NaN without |
| `depth_mm` | (N, H, W) float32 | exact z-depth, NaN where nothing was hit |
| `lit`, `shadow` | (N, H, W) bool | the projector sees the point; a surface that the projector does not see for another one |
| `projector_x`, `projector_y` | (N, H, W) float32 | exact tangent coordinates on the mask, NaN where nothing was hit |
| `reference_z_mm` | (N, h, w) float32 | the reference camera's depth map in its region of interest, NaN where invalid |
| `reference_rgba` | (N, h, w, 4) uint8 | its colour picture |
| `metadata` | (N, 16384) uint8 | JSON of the frame, UTF-8, zeros behind it |
| `tissue_seed`, `split`, `tool_in_view` | (N,) | the plan: which tissue, index into `SPLITS`, instrument in view |
| `done` | (N,) uint8, a chunk each | 1 once the frame is whole; written last |

Beside the arrays lies `calibration.json`, the calibration that `reference_depth_mm` was made with. A store appears whole, with
its plan and without frames; a frame that is not done does not exist. Chunks are written to the side and renamed by Zarr, so
that several processes may fill a store at once and be killed at any moment.
"""

import hashlib
import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, cast

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, MissingFileError, OutputError
from laploop.perception.calibration.calibration_file import load_calibration, save_calibration
from laploop.perception.calibration.results import StereoCalibration
from laploop.perception.data.frame_store import SPLITS
from laploop.perception.geometry import Intrinsics, Rig
from laploop.perception.reprojection import BrownDistortion, ReprojectedDepth, reproject

Float32 = NDArray[np.float32]
Bool = NDArray[np.bool_]

FORMAT = "laploop-pairs-1"
CALIBRATION = "calibration.json"
_METADATA_BYTES = 16384
_LEFT_BEHIND = "*.partial"
"""Files that Zarr had not renamed yet when its process was killed."""


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

    def sha256(self) -> str:
        """Return a hash over all bits of all arrays."""
        digest = hashlib.sha256()
        for field in fields(self):
            digest.update(np.ascontiguousarray(getattr(self, field.name)).tobytes())
        return digest.hexdigest()


_TYPES: dict[str, tuple[str, Any]] = {
    "image": ("uint8", 0),
    "reference_depth_mm": ("float32", np.nan),
    "depth_mm": ("float32", np.nan),
    "lit": ("bool", False),
    "shadow": ("bool", False),
    "projector_x": ("float32", np.nan),
    "projector_y": ("float32", np.nan),
    "reference_z_mm": ("float32", np.nan),
    "reference_rgba": ("uint8", 0),
}


class PairStore:
    """One paired data set on disk."""

    def __init__(self, group: Any, path: Path) -> None:
        """Wrap an open Zarr group; use `create` or `open`."""
        self._group = group
        self.path = path
        self.tissue_seed: NDArray[np.int64] = group["tissue_seed"][:]
        self.split: NDArray[np.uint8] = group["split"][:]
        self.tool_in_view: Bool = group["tool_in_view"][:]
        self.optics = _optics(group.attrs["optics"])
        """The nominal scope."""
        self.reference_intrinsics = Intrinsics(**group.attrs["reference_intrinsics"])
        """Of the reference camera's region of interest, as its maker calibrated it: makes `xyz` of `z`."""
        self.true_scope_from_reference: NDArray[np.float64] = np.array(group.attrs["true_scope_from_reference"])
        """4x4, metres; what only a simulator knows."""
        self.calibration: StereoCalibration = load_calibration(path / CALIBRATION)
        """What the reference depth was reprojected with."""
        self._rig = Rig.from_optics(self.optics)

    def __len__(self) -> int:
        """Return the number of planned pairs."""
        return len(self.split)

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
        if path.exists():
            raise OutputError(f"{path} exists already; give a new folder")
        count = len(split)
        scope, reference = (optics.height, optics.width), (reference_intrinsics.height, reference_intrinsics.width)
        partial = path.with_name(f".{path.name}.partial")
        try:
            if partial.exists():
                shutil.rmtree(partial)
            partial.mkdir(parents=True)
            group: Any = zarr.open_group(store=partial, mode="w")
            # The checksum is looked at first: given a damaged chunk, Blosc may crash the process.
            compressors = (BloscCodec(cname="zstd", clevel=4, shuffle="bitshuffle"), Crc32cCodec())
            for name, (dtype, fill) in _TYPES.items():
                shape = (*reference, 4) if name == "reference_rgba" else reference if name == "reference_z_mm" else scope
                group.create_array(
                    name, shape=(count, *shape), chunks=(1, *shape), dtype=dtype, fill_value=fill, compressors=compressors
                )
            group.create_array(
                "metadata", shape=(count, _METADATA_BYTES), chunks=(1, _METADATA_BYTES), dtype="uint8", fill_value=0
            )
            for name, values in (("tissue_seed", tissue_seed), ("split", split), ("tool_in_view", tool_in_view)):
                group.create_array(name, data=values)
            group.create_array("done", shape=(count,), chunks=(1,), dtype="uint8", fill_value=0)
            group.attrs.update(
                {
                    "optics": asdict(optics),
                    "reference_intrinsics": asdict(reference_intrinsics),
                    "true_scope_from_reference": true_scope_from_reference.tolist(),
                    "config": dict(config),
                    "format": FORMAT,
                }
            )
            save_calibration(partial / CALIBRATION, calibration)
            partial.rename(path)
        except OSError as error:
            raise OutputError(f"cannot write a data set to {path}: {error}") from error
        return cls.open(path, writable=True)

    @classmethod
    def open(cls, path: Path, *, writable: bool = False) -> "PairStore":
        """Open a store.

        Raises:
            MissingFileError: If there is none, or its calibration is missing.
            InvalidValueError: If it is of another format.
        """
        if not (path / "zarr.json").is_file():
            raise MissingFileError("data set", path, "make one with `laploop collect`")
        group = zarr.open_group(store=path, mode="r+" if writable else "r")
        found = group.attrs.get("format")
        if found != FORMAT:
            raise InvalidValueError(f"format of the data set {path}", found, FORMAT)
        return cls(group, path)

    @property
    def config(self) -> dict[str, object]:
        """What the pairs were made from."""
        return dict(cast("dict[str, object]", self._group.attrs["config"]))

    def done(self) -> Bool:
        """Return which pairs are whole, read afresh."""
        return np.asarray(self._group["done"][:]) > 0

    def count_done(self) -> int:
        """Return how many pairs are whole, from the files' names alone: quick enough to ask after each."""
        folder = self.path / "done" / "c"
        return sum(1 for file in folder.iterdir() if file.suffix == "") if folder.is_dir() else 0

    def write(self, index: int, frame: PairFrame, metadata: Mapping[str, object]) -> None:
        """Write one pair; it counts from the moment this returns. A hash of its arrays is added to the metadata.

        Raises:
            InvalidValueError: If the metadata are too long or not JSON.
            OutputError: If the disk refuses.
        """
        try:
            text = json.dumps({**metadata, "sha256": frame.sha256()}, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise InvalidValueError(f"metadata of pair {index}", dict(metadata), f"what JSON knows ({error})") from error
        if len(text) > _METADATA_BYTES:
            raise InvalidValueError(f"length of the metadata of pair {index}", len(text), f"at most {_METADATA_BYTES} bytes")
        padded = np.zeros(_METADATA_BYTES, dtype=np.uint8)
        padded[: len(text)] = np.frombuffer(text, dtype=np.uint8)
        try:
            for name in _TYPES:
                self._group[name][index] = getattr(frame, name)
            self._group["metadata"][index] = padded
            self._group["done"][index] = 1
        except OSError as error:
            raise OutputError(f"cannot write pair {index} to {self.path}: {error}; what was saved stays") from error

    def remove_left_behind(self) -> None:
        """Remove files that killed processes left half written; nobody may be writing meanwhile."""
        for file in self.path.rglob(_LEFT_BEHIND):
            file.unlink(missing_ok=True)

    def indices(self, split: str) -> NDArray[np.intp]:
        """Return the pairs of a split that are done.

        Raises:
            InvalidValueError: If the split is unknown or has no pair.
        """
        if split not in SPLITS:
            raise InvalidValueError("split", split, f"one of {', '.join(SPLITS)}")
        chosen = np.flatnonzero((self.split == SPLITS.index(split)) & self.done())
        if not len(chosen):
            raise InvalidValueError(f"number of pairs in split {split!r} of {self.path}", 0, "1 or more; finish the data set")
        return chosen

    def rig(self, index: int) -> Rig:
        """Return the rig of a pair: one scope took them all."""
        if not 0 <= index < len(self):
            raise InvalidValueError("index of a pair", index, f"0 to {len(self) - 1}")
        return self._rig

    def frame(self, index: int) -> PairFrame:
        """Read all arrays of a pair."""
        return PairFrame(**{name: self._read(name, index) for name in _TYPES})

    def image(self, index: int) -> NDArray[np.uint8]:
        """Read one image (H, W)."""
        return np.asarray(self._read("image", index))

    def depth_mm(self, index: int) -> Float32:
        """Read one exact depth map (H, W)."""
        return np.asarray(self._read("depth_mm", index))

    def reference_depth_mm(self, index: int) -> Float32:
        """Read the reference camera's depth in the scope's image (H, W); NaN where the paper's M is 0."""
        return np.asarray(self._read("reference_depth_mm", index))

    def lit(self, index: int) -> Bool:
        """Read where the projector reached (H, W)."""
        return np.asarray(self._read("lit", index))

    def shadow(self, index: int) -> Bool:
        """Read where a surface hides another one from the projector (H, W)."""
        return np.asarray(self._read("shadow", index))

    def projector_x(self, index: int) -> Float32:
        """Read the exact tangent coordinates across the stripes (H, W)."""
        return np.asarray(self._read("projector_x", index))

    def projector_y(self, index: int) -> Float32:
        """Read the exact tangent coordinates along the stripes (H, W)."""
        return np.asarray(self._read("projector_y", index))

    def reference_z_mm(self, index: int) -> Float32:
        """Read the reference camera's depth map (h, w)."""
        return np.asarray(self._read("reference_z_mm", index))

    def reference_rgba(self, index: int) -> NDArray[np.uint8]:
        """Read the reference camera's colour picture (h, w, 4)."""
        return np.asarray(self._read("reference_rgba", index))

    def reference_xyz_mm(self, index: int) -> Float32:
        """Return the reference camera's organised cloud (h, w, 3), to the bit what the camera gave; NaN where invalid."""
        return organised_cloud(self.reference_z_mm(index), self.reference_intrinsics)

    def reference_cloud_mm(self, index: int) -> Float32:
        """Return the reference camera's valid points (n, 3) in its frame."""
        cloud = self.reference_xyz_mm(index).reshape(-1, 3)
        return cloud[np.isfinite(cloud[:, 2])]

    def reproject_with(
        self, index: int, scope_from_reference: NDArray[np.float64], *, nominal_camera: bool = False
    ) -> ReprojectedDepth:
        """Show the reference camera's points in the scope's image by a transform (4x4, metres) of one's choice.

        The scope's camera is the calibrated one, or the nominal one without distortion.
        """
        cloud = self.reference_cloud_mm(index)
        if nominal_camera:
            return reproject(cloud, scope_from_reference, self._rig.camera)
        return reproject_by(self.calibration, cloud, scope_from_reference)

    def metadata(self, index: int) -> dict[str, Any]:
        """Read what is known about a pair."""
        text = bytes(self._read("metadata", index)).rstrip(b"\0")
        return cast("dict[str, Any]", json.loads(text))

    def _read(self, name: str, index: int) -> Any:
        return np.asarray(self._group[name][index])


def organised_cloud(z_mm: Float32, intrinsics: Intrinsics) -> Float32:
    """Make the points (h, w, 3) of a depth map (h, w) as the reference camera makes them, in single precision."""
    rays: Float32 = intrinsics.rays.astype(np.float32)
    return rays * z_mm[..., None]


def reproject_by(
    calibration: StereoCalibration, xyz_mm: Float32, scope_from_reference: NDArray[np.float64] | None = None
) -> ReprojectedDepth:
    """Show points (..., 3) of the reference camera in the scope's image by a calibration, or by another transform than its."""
    transform = calibration.scope_from_reference if scope_from_reference is None else scope_from_reference
    scope = calibration.scope
    distortion = None if scope.distortion == BrownDistortion() else scope.distortion
    return reproject(xyz_mm, transform, scope.intrinsics, distortion)


def _optics(values: Any) -> ScopeOptics:
    return ScopeOptics(**{**values, "mask": StripeMask(**values["mask"])})
