"""What the configurations of all tasks have in common."""

import math
from typing import Annotated, Literal

from laploop.configuration import Field, configuration
from laploop.envs.loop.config import LoopConfig
from laploop.perception.working_range import WORKING_RANGE_MM

ActionMode = Literal["tip-velocity", "tip-offset", "joint-velocity", "residual"]
"""What an action means; see `laploop.envs.tasks.actions`."""

ObservationMode = Literal["all", "stripes", "depth", "state"]
"""What an observation holds; see `laploop.envs.tasks.observations`."""
STRIPE_MODES = ("all", "stripes")
DEPTH_MODES = ("all", "depth")
"""Modes in which the image and the depth map are observed."""

Weight = Annotated[float, Field(ge=-1e4, le=1e4)]
Angle = Annotated[float, Field(gt=0.0, le=math.pi / 2)]
Force = Annotated[float, Field(gt=0.0, le=100.0)]
Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]
Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
Length = Annotated[float, Field(gt=0.0, le=0.1)]
Depth = Annotated[float, Field(gt=0.0, le=1.0)]


@configuration
class RewardWeights:
    """What each term of the reward counts; a term times its weight is what `info["reward_terms"]` shows."""

    distance: Weight = 1.0
    """Of the distance from the goal."""
    force: Weight = 0.5
    """Of newtons above the alarm."""
    effort: Weight = 0.02
    """Of the squared fraction of the largest commanded speed."""
    success: Weight = 10.0
    """Of solving the task."""
    harm: Weight = 10.0
    """Of passing a safety limit."""


@configuration
class TargetChoiceConfig:
    """What makes a pixel a fair target: seen, lit, where depth can be measured, in the middle, and facing camera and tool."""

    min_depth_m: Depth = WORKING_RANGE_MM[0] * 1e-3
    """Nearest depth."""
    max_depth_m: Depth = WORKING_RANGE_MM[1] * 1e-3
    """Farthest depth."""
    max_radius_m: Length = 0.02
    """Largest distance from the optical axis."""
    max_slope_rad: Angle = math.radians(40.0)
    """Largest angle between the surface's normal and the viewing ray."""
    max_tool_angle_rad: Angle = math.radians(65.0)
    """Largest angle between the normal and the direction to the tool's trocar."""
    clearance_m: Length = 0.004
    """Clearance of the tool's shaft around its axis, from 10 mm above the target on."""


@configuration
class TaskConfig:
    """Interface and limits of a task, around the loop and its theatre."""

    kind: str
    """The task."""
    action_mode: ActionMode = "tip-velocity"
    """What an action means: velocity or offset of the tip, joint velocities, or a residual to the scripted controller."""
    observation_mode: ObservationMode = "all"
    """What an observation holds."""
    bad_action: Literal["raise", "hold"] = "raise"
    """What happens to an action that is not finite: an error, or a tip that holds still for one control period."""
    max_seconds: Seconds = 10.0
    """Simulated time after which an episode is truncated."""
    marker: bool = False
    """Whether the target carries a painted marker, whose pixel controllers are given when it is seen."""
    max_tip_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.06
    """Bound of each component of a tip velocity."""
    max_joint_speed_radps: Annotated[float, Field(gt=0.0, le=10.0)] = 0.5
    """Bound of each component of a joint velocity."""
    yield_force_n: Force = 0.7
    """Without a usable command the tip stands still until it feels more than this, and then withdraws along its shaft."""
    yield_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    """Speed of that withdrawal."""
    alarm_force_n: Force = 2.0
    """Force from which the reward punishes pressing; below every tissue-damage threshold found for a small probe."""
    harm_force_n: Force = 5.0
    """Force on the tip that ends the episode."""
    harm_rcm_m: Length = 0.005
    """Distance of a shaft from its trocar that ends the episode."""
    rewards: RewardWeights = Field(default_factory=RewardWeights)
    target: TargetChoiceConfig = Field(default_factory=TargetChoiceConfig)
    loop: LoopConfig = Field(default_factory=LoopConfig)
