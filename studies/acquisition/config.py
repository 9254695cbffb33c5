"""The plan of an automated acquisition: how many pairs of how many tissues, where the stage goes, and who is tested on what."""

import json
import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.assets.ranges import Span
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.optics.presets import OpticsRanges
from laploop.errors import InvalidValueError, UnknownNameError, check_range
from laploop.perception.data.store import SPLITS
from laploop.studies.scenes.optical_bench import OpticalBench

ENGINES = ("process", "ray")
_STREAM = 83
"""Keeps the random numbers apart from those of other studies, whose seeds are small integers too."""
_SHARES = (26, 4, 8)
"""Tissues for training, validation and testing, of 38."""


@dataclass(frozen=True, kw_only=True)
class StageRanges:
    """Where the stage goes: the paper's working range and moderate surface poses."""

    working_distance_m: Span[float] = (0.060, 0.140)
    """From the scope to the mean height of the tissue; the positions of a tissue are spread evenly over it."""
    shift_m: float = 0.020
    """Largest sideways shift, along either axis."""
    tilt_rad: float = math.radians(10.0)
    """Largest tilt of the stage; the turntable goes to any angle."""
    repeatability_m: float = 5e-6
    repeatability_rad: float = math.radians(0.005)
    """Standard deviation, along and about each axis, between commanded and reached pose: a good motorised stage."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        low, high = self.working_distance_m
        if not 0.04 <= low <= high <= 0.3:
            raise InvalidValueError("working_distance_m", (low, high), "0.04 m <= low <= high <= 0.3 m")
        check_range("shift_m", self.shift_m, 0.0, 0.1)
        check_range("tilt_rad", self.tilt_rad, 0.0, 0.5)
        check_range("repeatability_m", self.repeatability_m, 0.0, 1e-3)
        check_range("repeatability_rad", self.repeatability_rad, 0.0, 0.02)


@dataclass(frozen=True, kw_only=True)
class AcquisitionConfig:
    """A collection of stripe frames paired with captures of the reference camera.

    Pair i belongs to one tissue; pairs are spread over the tissues as evenly as whole numbers allow, the first tissues taking
    what is left over. A tissue is in one split only.
    """

    pairs: int = 722
    tissues: int = 38
    """Fewer where there are fewer pairs."""
    split_tissues: tuple[int, int, int] | None = None
    """Tissues for training, validation and testing; by default 26 : 4 : 8, each at least one where there are three."""
    tool_share: float = 0.0
    """Share of the pairs with the instrument in view; the paper's phantom was alone."""
    seed: int = 0
    workers: int = 2
    engine: str = "process"
    """Who does the work: processes of this machine, or tasks of a Ray cluster; the pairs are the same."""
    calibration_views: int = 20
    """Views of the board for the calibration at the start, where none is given."""
    bench: OpticalBench = field(default_factory=OpticalBench)
    stage: StageRanges = field(default_factory=StageRanges)
    optics: OpticsRanges = field(default_factory=OpticsRanges)
    """Surfaces, blur and noise, drawn anew for every tissue around the bench's preset; its `light` is not used."""
    exposure_level: Span[float] = (0.25, 0.45)
    """The light is set once for a tissue, so that its brightest parts in the middle of the range reach this share of what the
    sensor holds: the nearest positions come close to saturation."""
    tissue: TissueConfig = field(default_factory=TissueConfig)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range, or the split does not add up.
            UnknownNameError: If there is no such engine.
        """
        for name, high in (("pairs", 1_000_000), ("tissues", 100_000), ("workers", 256)):
            check_range(name, getattr(self, name), 1, high)
        check_range("tool_share", self.tool_share, 0.0, 1.0)
        check_range("calibration_views", self.calibration_views, 5, 1000)
        if not 0.0 < self.exposure_level[0] <= self.exposure_level[1] <= 1.0:
            raise InvalidValueError("exposure_level", self.exposure_level, "0 < low <= high <= 1")
        if self.seed < 0:
            raise InvalidValueError("seed", self.seed, "an integer from 0")
        if self.engine not in ENGINES:
            raise UnknownNameError("engine", self.engine, ENGINES)
        if self.tissue.mesh is not None:
            raise InvalidValueError(
                "tissue.mesh", self.tissue.mesh, "none: every tissue of a collection is grown from its seed"
            )
        if self.split_tissues is not None:
            counts = tuple(self.split_tissues)
            if len(counts) != len(SPLITS) or min(counts) < 0 or sum(counts) != self.tissue_count:
                allowed = f"three numbers from 0 on (train, val, test) that add up to the {self.tissue_count} tissues"
                raise InvalidValueError("split_tissues", counts, allowed)

    @property
    def tissue_count(self) -> int:
        """Number of tissues that have a pair."""
        return min(self.tissues, self.pairs)

    @property
    def split_counts(self) -> tuple[int, int, int]:
        """Tissues for training, validation and testing."""
        if self.split_tissues is not None:
            return self.split_tissues
        count = self.tissue_count
        if count < len(SPLITS):
            return (1, 0, count - 1)
        val, test = (max(1, round(count * share / sum(_SHARES))) for share in _SHARES[1:])
        return (count - val - test, val, test)

    @property
    def tissue_of_pair(self) -> NDArray[np.int64]:
        """(pairs,), number of the tissue."""
        sizes = np.full(self.tissue_count, self.pairs // self.tissue_count)
        sizes[: self.pairs % self.tissue_count] += 1
        return np.repeat(np.arange(self.tissue_count, dtype=np.int64), sizes)

    @property
    def split_of_pair(self) -> NDArray[np.uint8]:
        """(pairs,), index into `SPLITS`."""
        of_tissue = np.repeat(np.arange(len(SPLITS), dtype=np.uint8), self.split_counts)
        return np.asarray(of_tissue[self.tissue_of_pair])

    @property
    def tool_in_view(self) -> NDArray[np.bool_]:
        """(pairs,), whether the instrument is put into the view."""
        return np.array([self.pair_rng(index).random() < self.tool_share for index in range(self.pairs)])

    def tissue_seed(self, tissue: int) -> list[int]:
        """Seed of a tissue: its shape, texture, light and surfaces."""
        return [self.seed, _STREAM, 0, tissue]

    def pair_seed(self, index: int) -> list[int]:
        """Seed of a pair: its position, instrument and noise."""
        return [self.seed, _STREAM, 1, index]

    def tissue_rng(self, tissue: int) -> np.random.Generator:
        """Return the generator of a tissue, at its start."""
        return np.random.default_rng(self.tissue_seed(tissue))

    def pair_rng(self, index: int) -> np.random.Generator:
        """Return the generator of a pair, at its start; its first number decides about the instrument."""
        return np.random.default_rng(self.pair_seed(index))

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the pairs' content, as JSON has it."""
        values = asdict(self)
        for name in ("workers", "engine"):
            del values[name]
        plain: dict[str, Any] = json.loads(json.dumps(values))
        return plain


@dataclass(frozen=True, kw_only=True, eq=False)
class StagePose:
    """Where the stage is sent."""

    working_distance_m: float
    shift_m: tuple[float, float]
    yaw_rad: float
    tilt_rad: float
    tilt_direction_rad: float
    world_from_stage: NDArray[np.float64]
    """4x4, of the middle of the stage's upper face."""


def draw_stage_pose(
    ranges: StageRanges, *, share: tuple[float, float], nominal_distance_m: float, height_m: float, rng: np.random.Generator
) -> StagePose:
    """Draw a pose whose working distance lies in a part of the range.

    Args:
        ranges: The ranges.
        share: Beginning and end of the part, 0 to 1.
        nominal_distance_m: From the scope to the world's origin.
        height_m: Mean height of the tissue above the stage; the pose turns about the tissue's middle at this height.
        rng: Source of the numbers.
    """
    low, high = ranges.working_distance_m
    distance = low + (high - low) * float(rng.uniform(*share))
    x, y = (float(value) for value in rng.uniform(-ranges.shift_m, ranges.shift_m, size=2))
    yaw, direction = (float(value) for value in rng.uniform(-math.pi, math.pi, size=2))
    tilt = float(rng.uniform(0.0, ranges.tilt_rad))
    return StagePose(
        working_distance_m=distance,
        shift_m=(x, y),
        yaw_rad=yaw,
        tilt_rad=tilt,
        tilt_direction_rad=direction,
        world_from_stage=_pose(
            np.array([x, y, nominal_distance_m - distance]),
            (
                Rotation.from_rotvec([tilt * math.cos(direction), tilt * math.sin(direction), 0.0])
                * Rotation.from_rotvec([0.0, 0.0, yaw])
            ).as_matrix(),
            height_m,
        ),
    )


def home_pose(ranges: StageRanges, *, nominal_distance_m: float, height_m: float) -> NDArray[np.float64]:
    """Return the pose, 4x4, that every motion starts from: the middle of the range, level."""
    return _pose(np.array([0.0, 0.0, nominal_distance_m - sum(ranges.working_distance_m) / 2.0]), np.eye(3), height_m)


def _pose(middle: NDArray[np.float64], rotation: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = middle - height_m * rotation[:, 2]
    return pose
