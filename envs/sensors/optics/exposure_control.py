"""An automatic exposure, as a camera's driver has it: it looks at an image and sets the next one's exposure time."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.errors import InvalidValueError, check_range

_SATURATED = 0.995
_LARGEST_STEP = 4.0


@dataclass(frozen=True, kw_only=True)
class ExposureControl:
    """Brings a percentile of the image to a target by changing the exposure time frame by frame.

    Grey values are proportional to it, so that a step of the full ratio would be right at once where nothing saturates. A step
    is limited to a factor of four, for an image that is all dark or all saturated says little about how far to go.
    """

    target: float = 0.6
    """Grey value that the percentile is to have, as a fraction of full scale."""
    percentile: float = 95.0
    """Of all grey values; 95 lies in the bright stripes, below the highlights."""
    gain: float = 0.8
    """Share of the logarithm of the ratio of target and grey value that a frame's step makes up for."""
    tolerance: float = 0.03
    """Relative difference from the target that is left alone, so that noise does not make the image flicker."""
    shortest_s: float = 2e-4
    longest_s: float = 0.03
    """What a camera that takes 30 images a second has time for."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        check_range("target", self.target, 0.02, 0.95)
        check_range("percentile", self.percentile, 0.0, 100.0)
        check_range("gain", self.gain, 0.05, 1.0)
        check_range("tolerance", self.tolerance, 0.0, 0.5)
        if not 0.0 < self.shortest_s <= self.longest_s:
            raise InvalidValueError("shortest_s and longest_s", (self.shortest_s, self.longest_s), "0 < shortest <= longest")

    def level(self, optics: StripeOptics, image: NDArray[Any]) -> float:
        """Return the image's percentile as a fraction of the full scale that its optics' bits have."""
        full_scale = float(2**optics.bits - 1)
        return float(np.percentile(image, self.percentile)) / full_scale

    def is_settled(self, optics: StripeOptics, image: NDArray[Any]) -> bool:
        """Tell whether an image taken with these optics is as bright as it should be, or as bright as the range allows."""
        return self.next(optics, image) == optics

    def next(self, optics: StripeOptics, image: NDArray[Any]) -> StripeOptics:
        """Return the optics for the next image, given those of this one and its grey values.

        Raises:
            InvalidValueError: If the image is empty.
        """
        if image.size == 0:
            raise InvalidValueError("size of image", image.shape, "at least one pixel")
        level = self.level(optics, image)
        # Of a saturated percentile it is only known that it is too bright; of one below a grey value, that it is too dark.
        if level >= _SATURATED:
            ratio = 1.0 / _LARGEST_STEP
        else:
            ratio = self.target / max(level, 0.5 / (2**optics.bits - 1))
            if abs(ratio - 1.0) <= self.tolerance:
                ratio = 1.0
        step = float(np.clip(ratio**self.gain, 1.0 / _LARGEST_STEP, _LARGEST_STEP))
        exposure = float(np.clip(optics.exposure_s * step, self.shortest_s, self.longest_s))
        return optics if exposure == optics.exposure_s else replace(optics, exposure_s=exposure)
