"""Automatic exposure, as in a camera's driver: each image sets the exposure time of the next."""

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

_SATURATED = 0.995
_LARGEST_STEP = 4.0

ExposureTime = Annotated[float, Field(ge=1e-6, le=1.0)]


@configuration
class ExposureControl:
    """Brings a percentile of the image to a target by changing the exposure time frame by frame.

    The signal is proportional to the exposure time, so that one step of the full ratio reaches the target where nothing
    saturates. A step is limited to a factor of four, since an image that is all dark or all saturated does not show how
    far the target is.
    """

    target: Annotated[float, Field(ge=0.02, le=0.95)] = 0.6
    """Grey value that the percentile should have, as a fraction of full scale."""
    percentile: Annotated[float, Field(ge=0.0, le=100.0)] = 95.0
    """Percentile of all grey values; 95 lies in the bright stripes, below the highlights."""
    gain: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Fraction of the logarithm of target over grey value that one frame corrects: 0 keeps the exposure time as it is, 0.8
    settles within six frames."""
    tolerance: Annotated[float, Field(ge=0.0, le=0.5)] = 0.03
    """Relative difference from the target that is not corrected, so that noise does not make the image flicker."""
    shortest_s: ExposureTime = 2e-4
    """Shortest exposure."""
    longest_s: ExposureTime = 0.03
    """The default fits 30 images a second."""

    def __post_init__(self) -> None:
        if not self.shortest_s <= self.longest_s:
            raise InvalidValueError("shortest_s", self.shortest_s, f"at most longest_s, {self.longest_s:g}")

    def next_exposure_s(self, exposure_s: float, image: NDArray[Any], bits: int, gamma: float = 1.0) -> float:
        """Return the exposure time for the next image.

        Args:
            exposure_s: That of this image.
            image: Grey values, of any shape.
            bits: Bits of a grey value.
            gamma: That of the camera's response.
        """
        if self.gain == 0.0:
            return exposure_s
        full_scale = float(2**bits - 1)
        level = float(np.percentile(image, self.percentile)) / full_scale
        # A saturated percentile shows only that the image is too bright; one below a grey value, that it is too dark.
        if level >= _SATURATED:
            ratio = 1.0 / _LARGEST_STEP
        else:
            ratio = self.target / max(level, 0.5 / full_scale)
            if abs(ratio - 1.0) <= self.tolerance:
                ratio = 1.0
        step = float(np.clip(ratio ** (self.gain * gamma), 1.0 / _LARGEST_STEP, _LARGEST_STEP))
        return float(np.clip(exposure_s * step, self.shortest_s, self.longest_s))
