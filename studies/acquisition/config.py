"""The plan of an automated acquisition: pairs, tissues, their splits, and where the stage goes."""

import math
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from laploop.assets.ranges import Span, check_ordered
from laploop.assets.tissue_config import TissueConfig
from laploop.configuration import Field, Seed, Workers, configuration, to_plain
from laploop.envs.sensors.optics.presets import OpticsRanges
from laploop.errors import InvalidValueError
from laploop.perception.data.dataset import SPLITS
from laploop.studies.calibration.config import CalibrationConfig, Views
from laploop.studies.scenes.optical_bench import OpticalBench

_STREAM = 83
"""Keeps the random numbers apart from those of other studies, whose seeds are small integers too."""
_SHARES = (26, 4, 8)
"""Tissues for training, validation and testing, of 38."""

Distance = Annotated[float, Field(ge=0.04, le=0.3)]
Level = Annotated[float, Field(ge=0.01, le=1.0)]
Count = Annotated[int, Field(ge=0, le=100_000)]


@configuration
class StageRanges:
    """Poses of the stage: the paper's working range and moderate tilts."""

    working_distance_m: Span[Distance] = (0.060, 0.140)
    """From the scope to the mean height of the tissue; the positions of a tissue are spread evenly over it."""
    shift_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.020
    """Largest sideways shift, along either axis."""
    tilt_rad: Annotated[float, Field(ge=0.0, le=0.5)] = math.radians(10.0)
    """Largest tilt of the stage; the turntable turns to any angle."""
    repeatability_m: Annotated[float, Field(ge=0.0, le=1e-3)] = 5e-6
    """Standard deviation of the stage's position."""
    repeatability_rad: Annotated[float, Field(ge=0.0, le=0.02)] = math.radians(0.005)
    """Standard deviation, along and about each axis, between commanded and reached pose: a good motorised stage."""

    def __post_init__(self) -> None:
        check_ordered(self)


@configuration
class AcquisitionConfig:
    """A collection of stripe frames paired with captures of the reference camera.

    Pairs are spread over the tissues as evenly as possible; where they do not divide, the first tissues have one more. A tissue
    is in one split only.
    """

    pairs: Annotated[int, Field(ge=1, le=1_000_000)] = 722
    """How many pairs of frames to collect."""
    tissues: Annotated[int, Field(ge=1, le=100_000)] = 38
    """At most as many as there are pairs."""
    split_tissues: tuple[Count, Count, Count] | None = None
    """Tissues for training, validation and testing; by default 26 : 4 : 8, each at least one where there are three."""
    tool_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Fraction of the pairs with the instrument in view; the paper's phantom was alone."""
    seed: Seed = 0
    """Decides the tissues, the poses and all noise."""
    workers: Workers = 2
    """Processes that take the pairs, which do not depend on their number."""
    engine: Literal["process", "ray"] = "process"
    """Processes of this machine, or tasks of a Ray cluster; the pairs are the same."""
    calibration_views: Views = 20
    """Views of the board for the calibration at the start, where none is given."""
    bench: OpticalBench = field(default_factory=OpticalBench)
    stage: StageRanges = field(default_factory=StageRanges)
    optics: OpticsRanges = field(default_factory=OpticsRanges)
    """Surfaces, blur and noise, drawn anew for every tissue around the bench's preset; its `light` is not used."""
    exposure_level: Span[Level] = (0.25, 0.45)
    """The light is set once for a tissue, so that its brightest parts in the middle of the range reach this fraction of what
    the sensor holds: the nearest positions come close to saturation."""
    tissue: TissueConfig = field(default_factory=TissueConfig)

    def __post_init__(self) -> None:
        if not self.exposure_level[0] <= self.exposure_level[1]:
            raise InvalidValueError("exposure_level", self.exposure_level, "low <= high")
        if self.tissue.mesh is not None:
            raise InvalidValueError(
                "tissue.mesh", self.tissue.mesh, "none: every tissue of a collection is grown from its seed"
            )
        if self.split_tissues is not None and sum(self.split_tissues) != self.tissue_count:
            allowed = f"three numbers from 0 on (train, val, test) that add up to the {self.tissue_count} tissues"
            raise InvalidValueError("split_tissues", self.split_tissues, allowed)

    @property
    def calibration(self) -> CalibrationConfig:
        """What is calibrated before a collection: both cameras and the transform, over the whole image."""
        bench = replace(self.bench, reference=replace(self.bench.reference, region=None))
        return CalibrationConfig(views=self.calibration_views, seed=self.seed, bench=bench, projector=False, hand_eye=False)

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
        return {name: value for name, value in to_plain(self).items() if name not in {"workers", "engine"}}
