"""The stages of the loop and their timing."""

import re
from typing import Annotated

from laploop.configuration import Field, configuration
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.envs.loop.faults import Fault
from laploop.envs.loop.kinematic_errors import KinematicErrors
from laploop.envs.loop.proprioception import ProprioceptionConfig
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.envs.theatre.config import TheatreConfig
from laploop.errors import InvalidValueError


@configuration
class LoopConfig(ClockRates):
    """The rates and the stages of the loop, around the theatre."""

    timing: TimingConfig = Field(default_factory=TimingConfig)
    """How long the stages between a scene and the arm take."""
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
        if self.timing.exposure_ns > self.camera_ns:
            allowed = f"at most the camera period, {self.camera_ns * 1e-6:g} ms"
            raise InvalidValueError("timing.exposure_ms", self.timing.exposure_ms, allowed)
        try:
            self.theatre.check_timestep(self.physics_ns)
        except InvalidValueError as error:
            raise error.at("theatre") from None
