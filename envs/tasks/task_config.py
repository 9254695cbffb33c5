"""What all tasks have in common to choose."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from laploop.assets.tissue_config import TissueConfig
from laploop.envs.loop.closed_loop import LoopConfig
from laploop.envs.tasks.target_choice import TargetChoiceConfig
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.envs.theatre.stage_travel import StageTravel
from laploop.errors import InvalidValueError, UnknownNameError

ActionMode = Literal["tip-velocity", "tip-offset", "joint-velocity", "residual"]
"""What an action means; `laploop.envs.tasks.actions` says it in full."""

ObservationMode = Literal["all", "stripes", "depth", "state"]
"""What an observation holds; `laploop.envs.tasks.observations` says it in full."""

BadAction = Literal["raise", "hold"]
"""What becomes of an action that is not finite: an error, or a tip that stands still for one control period and only
withdraws, along its shaft, from tissue that presses on it."""


@dataclass(frozen=True, kw_only=True)
class TaskConfig:
    """Theatre, loop, interface and limits of a task."""

    motion: BaseMotion = field(default_factory=BaseMotion)
    travel: StageTravel = field(default_factory=StageTravel)
    loop: LoopConfig = field(default_factory=LoopConfig)
    target: TargetChoiceConfig = field(default_factory=TargetChoiceConfig)
    tissue: TissueConfig = field(default_factory=TissueConfig)
    scope_distance_m: float | None = None
    """From the scope's tip to the mean height of the tissue at rest, 55 to 150 mm; None draws it from 75 to 105 mm."""
    tissue_seed: int | None = None
    """Seed of the tissue; None takes the seed of `reset`, and draws a new one where that is None too."""
    action_mode: ActionMode = "tip-velocity"
    observation_mode: ObservationMode = "all"
    bad_action: BadAction = "raise"
    yield_force_n: float = 0.7
    """Without a usable command the tip stands still until it feels more than this, and then withdraws along its shaft."""
    yield_speed_mps: float = 0.03
    marker: bool = False
    """Whether the target carries a painted marker, whose pixel controllers are told when it is seen."""
    max_seconds: float = 10.0
    """Simulated time after which an episode is truncated."""
    max_tip_speed: float = 0.06
    """Bound of each component of a tip velocity, in m/s."""
    max_joint_speed: float = 0.5
    """Bound of each component of a joint velocity, in rad/s."""
    alarm_force_n: float = 2.0
    """Force from which the reward punishes pressing; below every tissue-damage threshold found for a small probe."""
    harm_force_n: float = 5.0
    harm_rcm_m: float = 0.005

    def __post_init__(self) -> None:
        """Check names and ranges.

        Raises:
            UnknownNameError: If a mode has an unknown name.
            InvalidValueError: If a value is not positive.
        """
        for kind, name, available in (
            ("action mode", self.action_mode, get_args(ActionMode)),
            ("observation mode", self.observation_mode, get_args(ObservationMode)),
            ("reaction to a bad action", self.bad_action, get_args(BadAction)),
        ):
            if name not in available:
                raise UnknownNameError(kind, name, available)
        self.check_positive(
            "max_seconds",
            "max_tip_speed",
            "max_joint_speed",
            "yield_force_n",
            "yield_speed_mps",
            "alarm_force_n",
            "harm_force_n",
            "harm_rcm_m",
        )

    def check_positive(self, *names: str) -> None:
        """Raise unless all these fields are above 0.

        Raises:
            InvalidValueError: If one is not.
        """
        for name in names:
            if not getattr(self, name) > 0.0:
                raise InvalidValueError(name, getattr(self, name), "above 0")
