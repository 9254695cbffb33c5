"""What may be chosen about a theatre, and where its furniture stands."""

import math
from dataclasses import dataclass, field

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.envs.theatre.stage_travel import StageTravel
from laploop.envs.theatre.trocar import TrocarConfig
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class TheatreLayout:
    """Fixed places in the world: z up, metres, origin on the table top under the middle of the phantom."""

    scope_tip_z_m: float = 0.200
    """Height of the scope's tip, which looks straight down at the origin."""
    wall_z_m: float = 0.310
    """Height of the abdominal wall, about 0.2 m above the tissue, as under pneumoperitoneum."""
    tool_trocar_x_m: float = 0.175
    """The tool's trocar lies beside the scope's, a usual port distance away; the shaft is then tilted by 40 to 45 degrees."""
    camera_base_x_m: float = -0.55
    tool_base_x_m: float = 0.75
    """Both bases stand on the table top; the tool's shaft leans away from the scope, which puts its flange farther out."""

    def __post_init__(self) -> None:
        """Check that the shafts can pass the wall.

        Raises:
            InvalidValueError: If the wall is not well above the scope's tip, or the trocars would touch.
        """
        if not 0.12 <= self.scope_tip_z_m <= self.wall_z_m - 0.03:
            raise InvalidValueError("scope_tip_z_m", self.scope_tip_z_m, "0.12 m to 0.03 m below wall_z_m")
        if not self.tool_trocar_x_m >= 0.03:
            raise InvalidValueError("tool_trocar_x_m", self.tool_trocar_x_m, "at least 0.03 m from the scope's")


@dataclass(frozen=True, kw_only=True)
class TheatreConfig:
    """Everything that a theatre is made from; equal configs make equal theatres, to the bit."""

    seed: int
    motion: BaseMotion = field(default_factory=BaseMotion)
    travel: StageTravel = field(default_factory=StageTravel)
    actuation: ActuationConfig = field(default_factory=ActuationConfig)
    """How both arms follow their joint targets."""
    trocar: TrocarConfig = field(default_factory=TrocarConfig)
    """What wall and seal do to both shafts."""
    working_distance_m: float | None = None
    """From the scope's tip down to the mean height of the tissue at rest; None draws it from 75 to 105 mm."""
    timestep_s: float = 0.002
    control_period_s: float = 0.008
    """How long a joint target is extrapolated by its velocity; the period of the UR5's own control loop (125 Hz)."""
    tissue: TissueConfig = field(default_factory=TissueConfig)
    optics: ScopeOptics = field(default_factory=ScopeOptics)
    layout: TheatreLayout = field(default_factory=TheatreLayout)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InvalidValueError("seed", self.seed, "an integer from 0")
        if self.working_distance_m is not None and not 0.055 <= self.working_distance_m <= 0.150:
            raise InvalidValueError("working_distance_m", self.working_distance_m, "0.055 to 0.150 m, or None")
        if not 0.0002 <= self.timestep_s <= 0.005 or not _whole(self.timestep_s * 1e9):
            raise InvalidValueError("timestep_s", self.timestep_s, "0.0002 to 0.005 s, a whole number of nanoseconds")
        if not self.control_period_s >= self.timestep_s or not _whole(self.control_period_s / self.timestep_s):
            raise InvalidValueError("control_period_s", self.control_period_s, "a whole number of physics steps, at least one")
        self.trocar.check_timestep(self.timestep_s)

    @property
    def timestep_ns(self) -> int:
        """The physics step in nanoseconds."""
        return round(self.timestep_s * 1e9)

    @property
    def control_steps(self) -> int:
        """Physics steps in a control period."""
        return round(self.control_period_s / self.timestep_s)


def _whole(value: float) -> bool:
    return math.isclose(value, round(value), rel_tol=0.0, abs_tol=1e-6)
