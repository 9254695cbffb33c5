"""Configurations of the built-in tasks."""

import math
from typing import Annotated, Any, Literal

from laploop.configuration import Field, configuration
from laploop.envs.loop.config import LoopConfig
from laploop.envs.tasks.task_config import (
    Angle,
    Force,
    Fraction,
    Length,
    RewardWeights,
    Seconds,
    TargetChoiceConfig,
    TaskConfig,
    Weight,
)
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.errors import InvalidValueError


def _loop_around(**theatre: Any) -> LoopConfig:
    return LoopConfig(theatre=TheatreConfig(**theatre))


@configuration
class ReachRewardWeights(RewardWeights):
    """What each term of the reach task's reward counts."""

    progress: Weight = 20.0
    """Of the distance gained in a control period."""
    contact: Weight = 0.1
    """Of touching near the target."""


@configuration
class ReachConfig(TaskConfig):
    """The reach task: touch a point."""

    kind: Literal["reach"] = "reach"
    rewards: ReachRewardWeights = Field(default_factory=ReachRewardWeights)
    success_radius_m: Length = 0.0015
    """Largest distance of the tip from an ideal touch."""
    success_hold_s: Seconds = 0.3
    """How long it must be kept without a break."""


@configuration
class TrackRewardWeights(RewardWeights):
    """What each term of the tracking task's reward counts."""

    normal: Weight = 1.0
    """Of the error along the normal."""
    contact: Weight = 1.0
    """Of touching anything."""


@configuration
class TrackConfig(TaskConfig):
    """The tracking task: hold a constant distance over a moving point."""

    kind: Literal["track"] = "track"
    rewards: TrackRewardWeights = Field(default_factory=TrackRewardWeights)
    loop: LoopConfig = Field(default_factory=lambda: _loop_around(motion=BaseMotion.named("both")))
    max_seconds: Seconds = 20.0
    standoff_m: Length = 0.003
    """Between the ball end and the tissue."""
    settle_s: Seconds = 10.0
    """Nothing is assessed before: the tip must get there, and a predictor learn the motion."""
    max_rms_m: Length = 0.001
    """Largest root mean square error along the normal of a successful episode."""


@configuration
class PalpateRewardWeights(RewardWeights):
    """What each term of the palpation task's reward counts."""

    band: Weight = 1.0
    """Of a force in its band."""
    deviation: Weight = 0.5
    """Of the force's relative distance from its goal."""


@configuration
class PalpateConfig(TaskConfig):
    """The palpation task: hold a light force."""

    kind: Literal["palpate"] = "palpate"
    rewards: PalpateRewardWeights = Field(default_factory=PalpateRewardWeights)
    max_seconds: Seconds = 15.0
    harm_force_n: Force = 2.0
    """Palpation never needs more, so the episode ends there."""
    alarm_force_n: Force = 1.0
    force_n: Force = 0.5
    """Force to hold."""
    tolerance_n: Force = 0.1
    """Half the width of the band around it."""
    success_hold_s: Seconds = 3.0
    """How long the force must be held."""
    hold_share: Fraction = 0.95
    """Fraction of that time that the force must be in its band."""
    max_miss_m: Length = 0.005
    """Largest distance of the tip from an ideal touch of the target at which a force counts."""

    def __post_init__(self) -> None:
        if not self.tolerance_n < self.force_n < self.harm_force_n - self.tolerance_n:
            raise InvalidValueError("force_n", self.force_n, "above tolerance_n, and below harm_force_n by more than that")


@configuration
class PathChoiceConfig:
    """What makes a line a fair path: seen, lit, smooth, and within the tool's reach along all its length."""

    length_m: Annotated[float, Field(ge=0.01, le=0.3)] = 0.060
    """On the surface."""
    min_share: Fraction = 0.5
    """Least fraction of `length_m` that will do where the tissue has no room for all of it; 1 insists on the whole."""
    spacing_m: Annotated[float, Field(ge=0.0005, le=0.06)] = 0.002
    """Between neighbouring points, at most a fifth of the length."""
    max_turn_rad: Annotated[float, Field(ge=0.0, le=1.0)] = math.radians(14.0)
    """From one stretch to the next; 14 degrees every 2 mm make circles of 8 mm."""
    candidates: Annotated[int, Field(ge=1, le=1000)] = 4
    """Of this many lines that qualify, the one with the least steep surroundings is taken; 1 takes the first."""
    pixels: TargetChoiceConfig = Field(
        default_factory=lambda: TargetChoiceConfig(min_depth_m=0.062, max_radius_m=0.040, max_tool_angle_rad=math.radians(70.0))
    )
    """What each of its points must keep: 2 mm from the near end of the working range too, about which an estimator cannot be
    sure, and many of its pixels must be valid in one frame."""

    def __post_init__(self) -> None:
        if self.spacing_m > 0.2 * self.length_m:
            raise InvalidValueError("spacing_m", self.spacing_m, "0.0005 m to a fifth of length_m")

    @property
    def points(self) -> int:
        """Number of points of a path."""
        return round(self.length_m / self.spacing_m) + 1


@configuration
class ScanRewardWeights(RewardWeights):
    """What each term of the scanning task's reward counts."""

    progress: Weight = 1.0
    """Of millimetres scanned."""
    standoff: Weight = 1.0
    """Of the error of the stand-off."""
    contact: Weight = 1.0
    """Of touching anything."""


@configuration
class ScanConfig(TaskConfig):
    """The scanning task: follow a line at a constant distance."""

    kind: Literal["scan"] = "scan"
    rewards: ScanRewardWeights = Field(default_factory=ScanRewardWeights)
    # Near, where depth is best; 92 mm of tissue are in view there.
    loop: LoopConfig = Field(default_factory=lambda: _loop_around(working_distance_m=0.080))
    path: PathChoiceConfig = Field(default_factory=PathChoiceConfig)
    max_seconds: Seconds = 30.0
    standoff_m: Length = 0.003
    """Between the ball end and the tissue."""
    start_radius_m: Length = 0.0015
    """The scan begins once the tip is this near to its place above the start of the path."""
    lost_radius_m: Length = 0.006
    """No progress is made with the tip farther than this from its place above the path."""
    max_rms_m: Length = 0.001
    """Largest root mean square error of the stand-off of a successful scan."""
    max_incidence_rad: Angle = math.radians(10.0)
    """Largest mean incidence of one."""


@configuration
class LookRewardWeights(RewardWeights):
    """What each term of the looking task's reward counts."""

    centre: Weight = 1.0
    """Of the distance from the middle of the view."""


@configuration
class LookConfig(TaskConfig):
    """The looking task: keep a moving point in the middle of the view."""

    kind: Literal["look"] = "look"
    rewards: LookRewardWeights = Field(default_factory=LookRewardWeights)
    loop: LoopConfig = Field(
        default_factory=lambda: _loop_around(
            motion=BaseMotion.named("breathing"), travel=StageTravel(x_peak_to_peak_m=0.020, y_peak_to_peak_m=0.020)
        )
    )
    marker: bool = True
    max_tip_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    working_distance_m: Annotated[float, Field(ge=0.05, le=0.15)] = 0.085
    """From the camera to the target, along the optical axis."""
    settle_s: Seconds = 2.0
    """Nothing is assessed before."""
    max_centre_share: Fraction = 0.05
    """Largest distance of the target from the middle of the image, as a fraction of its width."""
    max_distance_error_m: Length = 0.005
    """Largest error of the working distance."""
    hold_share: Fraction = 0.95
    """Fraction of the time after `settle_s` that both must hold in a successful episode."""
