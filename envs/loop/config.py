"""The stages of the loop and their timing."""

import re
from typing import Annotated

from laploop.configuration import Field, configuration
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.envs.loop.faults import Fault
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.loop.latency import ConstantLatency, LatencyModel
from laploop.envs.loop.proprioception import ProprioceptionConfig
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.envs.theatre.config import TheatreConfig
from laploop.errors import InvalidValueError


@configuration
class LoopConfig(ClockRates):
    """The rates and the stages of the loop, around the theatre."""

    latency: Annotated[LatencyModel, Field(discriminator="kind")] = Field(default_factory=ConstantLatency)
    """Service time of the perception stage, which keeps it busy."""
    transfer_ms: Annotated[float, Field(ge=0.0, le=5000.0)] = 0.0
    """From the capture of a frame to its arrival at the perception stage; keeps nobody busy."""
    device: str = "cpu"
    """Where stripes are rendered: cpu, cuda, or one of several GPUs as cuda:0."""
    theatre: TheatreConfig = Field(default_factory=TheatreConfig)
    optics: StripeOptics = Field(default_factory=StripeOptics)
    """Light, surfaces, lens and sensor of the stripe camera."""
    proprioception: ProprioceptionConfig = Field(default_factory=ProprioceptionConfig)
    rcm: RcmControllerConfig = Field(default_factory=RcmControllerConfig)
    kinematic_errors: KinematicErrors = Field(default_factory=KinematicErrors)
    """What each arm's kinematics and the hand-eye calibration get wrong, drawn anew in every episode."""
    faults: Annotated[tuple[Fault, ...], Field(min_length=0, max_length=1000)] = ()
    """Failures of sensors and controller, at chosen times."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not re.fullmatch(r"cpu|cuda(:\d+)?", self.device):
            raise InvalidValueError("device", self.device, "cpu, cuda, or a number behind it as in cuda:0")
        try:
            self.theatre.check_timestep(self.physics_ns)
        except InvalidValueError as error:
            raise error.at("theatre") from None

    @property
    def transfer_ns(self) -> int:
        """From the capture of a frame to its arrival at the perception stage, in nanoseconds."""
        return round(self.transfer_ms * 1e6)
