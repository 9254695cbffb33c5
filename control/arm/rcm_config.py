"""Limits and weights of the trocar-constrained controller."""

from typing import Annotated, Literal

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError


@configuration
class RcmControllerConfig:
    """Limits and weights of `RcmController`.

    The tip's speed and acceleration are bounded because a hard constraint holds to first order a step: at 60 mm/s and 125 Hz
    a step of 0.5 mm leaves some micrometres at the trocar, which the next step takes out.
    """

    max_tip_speed_mps: Annotated[float, Field(gt=0.0, le=1.0)] = 0.06
    """Speed limit of the tip's reference."""
    max_tip_acceleration_mps2: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """Acceleration limit of the tip's reference."""
    max_joint_speed_radps: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    """Speed limit of each joint's reference, besides the arm's own limit; slows the arm down near a singularity."""
    max_joint_acceleration_radps2: Annotated[float, Field(gt=0.0, le=1000.0)] = 15.0
    """Acceleration limit of each joint's reference."""
    min_insertion_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """Least distance from the trocar to the tip."""
    max_insertion_m: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    """Greatest distance from the trocar to the tip; by default 50 mm less than the shaft, to keep the flange off the wall."""
    wall_outwards: tuple[float, float, float] | Literal["none"] = (0.0, 0.0, 1.0)
    """Normal of the wall around the trocar, in the world's frame, out of the patient; `none` for no wall."""
    min_tip_depth_m: Annotated[float, Field(ge=0.0, le=1.0)] = 0.01
    """Least depth of the tip below the wall."""
    min_flange_height_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.03
    """Least height of the flange above the wall; what it holds is up to 20 mm thick around the shaft."""
    shaft_clearance_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.003
    """Least clearance between the surfaces of this shaft and another one."""
    rcm_feedback: Annotated[float, Field(gt=0.0, le=1.0)] = 0.5
    """Fraction of the trocar's error that one step takes out."""
    max_rcm_correction_mps: Annotated[float, Field(gt=0.0, le=0.1)] = 0.005
    """Fastest correction of the trocar's error."""
    max_start_error_m: Annotated[float, Field(gt=0.0, le=0.01)] = 1e-3
    """Largest trocar error of a posture that `reset` accepts."""
    max_lag_m: Annotated[float, Field(gt=0.0, le=0.01)] = 5e-4
    """How far the tip's reference may run ahead of a tip that limits hold back."""
    tip_cost_per_m: Annotated[float, Field(gt=0.0, le=1e6)] = 1e3
    """Weight of the tip's task."""
    posture_cost_per_rad: Annotated[float, Field(gt=0.0, le=1e3)] = 1e-2
    """Weight of the pull to the posture of `reset`; far below the tip's, it acts on the roll about the shaft only."""
    posture_gain: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    """Fraction of the posture's error that one step takes out."""

    def __post_init__(self) -> None:
        if self.max_insertion_m is not None and self.max_insertion_m <= self.min_insertion_m:
            raise InvalidValueError("max_insertion_m", self.max_insertion_m, f"above min_insertion_m ({self.min_insertion_m})")
        if self.wall_outwards == (0.0, 0.0, 0.0):
            raise InvalidValueError("wall_outwards", self.wall_outwards, "a vector that is not zero")
