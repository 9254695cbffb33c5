"""How a camera turns its signal into grey values."""

from typing import Annotated

from laploop.configuration import Field, configuration


@configuration
class CameraResponse:
    """Grey value = full scale * (gain * signal)^(1 / gamma), cut off at full scale.

    The signal is the charge of a pixel, noise included, as a fraction of the full well. The default is linear, as of a machine
    vision camera; consumer cameras and endoscope processors encode with a gamma near 2.2.
    """

    gain: Annotated[float, Field(ge=0.01, le=100.0)] = 1.0
    """Factor on the signal before it becomes grey values."""
    gamma: Annotated[float, Field(ge=0.4, le=4.0)] = 1.0
    """Exponent of the response; 1 is linear."""

    def signal(self, level: float) -> float:
        """Return the signal, a fraction of the full well, whose grey value is a fraction (0 to 1) of full scale."""
        return float(level**self.gamma) / self.gain
