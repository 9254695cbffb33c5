"""What a depth evaluation measures; nothing here loads torch, the simulator or a data set."""

from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError
from laploop.perception.cramer_rao import SensorNoise
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.studies.depth.calibration_residual import CalibrationResidual

Millimetres = Annotated[float, Field(gt=0.0, le=10_000.0)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


@configuration
class DepthEvaluation:
    """Which frames and pixels count, and against what."""

    split: Literal["train", "val", "test"] = "test"
    """Which frames of the data set."""
    against: Literal["exact", "zivid", "both"] = "exact"
    """exact: exact depth, in the range of depth. zivid: the reference camera's reprojected depth, over its whole mask, which
    is the paper's protocol. both: both, and exact depth over the mask, which shows how much of an error is the reference's."""
    nearest_mm: Millimetres = WORKING_RANGE_MM[0]
    """Least depth that counts."""
    farthest_mm: Millimetres = WORKING_RANGE_MM[1]
    """Pixels whose exact depth lies outside are left out of `exact`."""
    bins_mm: tuple[Millimetres, ...] = (60.0, 80.0, 100.0, 120.0, 140.0)
    """Edges of the bins of working distance: the median of a frame's exact depth, or of the reference's where none is exact."""
    weights: dict[str, Path] = field(default_factory=dict)
    """Replaces the shipped weights: pairs of a model's name and its file, or folder for dpt and depth-anything."""
    residual_mm: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Puts an error into the calibration and reprojects the reference camera's points anew, for `zivid` and `both`: the
    translation is off by exactly this, in a direction that `residual_seed` draws."""
    residual_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 0.0
    """The rotation is off by exactly this, about an axis that `residual_seed` draws."""
    residual_seed: Seed = 0
    """Decides the directions of the calibration residual."""
    floor_rows: tuple[Annotated[int, Field(ge=1, le=64)], ...] = (1, 5)
    """Heights in pixels of the windows, one period wide, whose photon floor is given; none leaves it out."""
    sensor: SensorNoise = SensorNoise()
    """The sensor that the floor assumes."""
    resamples: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Draws of the bootstrap over tissues."""
    bootstrap_seed: Seed = 0
    """Decides the resampling behind the intervals."""
    examples: Annotated[int, Field(ge=0, le=20)] = 5
    """Frames kept for the figures."""

    def __post_init__(self) -> None:
        if self.nearest_mm >= self.farthest_mm:
            raise InvalidValueError("nearest_mm and farthest_mm", (self.nearest_mm, self.farthest_mm), "0 < nearest < farthest")
        if len(self.bins_mm) < 2 or list(self.bins_mm) != sorted(set(self.bins_mm)):
            raise InvalidValueError("bins_mm", self.bins_mm, "two or more rising edges")
        if not self.residual.nothing and self.against == "exact":
            sizes = (self.residual_mm, self.residual_deg)
            raise InvalidValueError("residual_mm and residual_deg", sizes, "0 against exact depth; choose zivid or both")

    @property
    def residual(self) -> CalibrationResidual:
        """The error that is put into the calibration."""
        return CalibrationResidual(mm=self.residual_mm, deg=self.residual_deg, seed=self.residual_seed)


@configuration
class RobustnessConfig:
    """How many frames a condition."""

    tissues: Annotated[int, Field(ge=1, le=1000)] = 6
    """How many tissues are rendered under each condition."""
    frames_per_tissue: Annotated[int, Field(ge=1, le=1000)] = 4
    """Frames of each of them."""
    seed: Annotated[int, Field(ge=0, le=2**31)] = 0
    """Decides the tissues and all noise."""
    noise_seeds: Annotated[int, Field(ge=2, le=1000)] = 10
    """Images of each still scene, one a tissue, that differ in their noise alone: how much depth jitters."""

    @property
    def frames(self) -> int:
        """Frames of one condition."""
        return self.tissues * self.frames_per_tissue
