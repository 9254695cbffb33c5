"""What a theatre is made of, and where its furniture stands."""

from typing import Annotated

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_config import TissueConfig
from laploop.configuration import Field, configuration
from laploop.envs.theatre.actuation import ActuationConfig
from laploop.envs.theatre.organ_motion import BaseMotion, StageTravel
from laploop.envs.theatre.trocar import TrocarConfig
from laploop.errors import InvalidValueError


@configuration
class TheatreLayout:
    """Fixed places in the world: z up, metres, origin on the table top under the middle of the phantom."""

    scope_tip_z_m: Annotated[float, Field(ge=0.12, le=0.5)] = 0.200
    """Height of the scope's tip, which looks straight down at the origin; at least 0.03 m below the wall."""
    wall_z_m: Annotated[float, Field(ge=0.15, le=0.6)] = 0.310
    """Height of the abdominal wall, about 0.2 m above the tissue, as under pneumoperitoneum."""
    tool_trocar_x_m: Annotated[float, Field(ge=0.03, le=0.4)] = 0.175
    """The tool's trocar lies beside the scope's, a usual port distance away; the shaft is then tilted by 40 to 45 degrees."""
    camera_base_x_m: Annotated[float, Field(ge=-1.5, le=1.5)] = -0.55
    """Where the camera arm stands on the table top."""
    tool_base_x_m: Annotated[float, Field(ge=-1.5, le=1.5)] = 0.75
    """Where the tool arm stands; its shaft leans away from the scope, which puts its flange farther out."""

    def __post_init__(self) -> None:
        if self.scope_tip_z_m > self.wall_z_m - 0.03:
            raise InvalidValueError("scope_tip_z_m", self.scope_tip_z_m, "at least 0.03 m below wall_z_m")


@configuration
class TheatreConfig:
    """Everything that a theatre is made of; equal configurations and seeds make equal theatres, to the bit."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = None
    """Fixes the tissue, the phases of its motion and where the tip starts; by default the episode's seed decides them."""
    working_distance_m: Annotated[float, Field(ge=0.055, le=0.150)] | None = None
    """From the scope's tip down to the mean height of the tissue at rest; by default the seed draws 0.075 to 0.105 m."""
    tissue: TissueConfig = Field(default_factory=TissueConfig)
    motion: BaseMotion = Field(default_factory=BaseMotion)
    travel: StageTravel = Field(default_factory=StageTravel)
    layout: TheatreLayout = Field(default_factory=TheatreLayout)
    trocar: TrocarConfig = Field(default_factory=TrocarConfig)
    """What wall and seal do to both shafts."""
    actuation: ActuationConfig = Field(default_factory=ActuationConfig)
    """How both arms follow their joint targets."""
    scope: ScopeOptics = Field(default_factory=ScopeOptics)
    """Geometry of the laparoscope's camera and projector."""

    def check_timestep(self, timestep_ns: int) -> None:
        """Raise an InvalidValueError unless trocar and actuation fit the physics step."""
        for name, part in (("trocar", self.trocar), ("actuation", self.actuation)):
            try:
                part.check_timestep(timestep_ns)
            except InvalidValueError as error:
                raise error.at(name) from None
