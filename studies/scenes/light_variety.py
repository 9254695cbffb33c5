"""How differently tissues spread light, and cameras encode it."""

import numpy as np

from laploop.assets.ranges import Span
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.subsurface import Subsurface

_NONE, _DIPOLE = 0.05, 0.45
"""Fractions of the tissues without spread, and with that of a diffusion dipole; the others have a Gaussian spot."""
_REDUCED_SCATTERING_PER_M: Span[float] = (600.0, 2000.0)
_ABSORPTION_PER_M: Span[float] = (50.0, 500.0)
"""About 1 and 0.05 to 0.5 per millimetre in soft tissue in the visible; drawn evenly in the logarithm."""
_ENCODED = 0.4
"""Fraction of the cameras whose response is not linear."""
_GAMMA: Span[float] = (1.2, 2.6)
"""Around 2.2, with which consumer cameras and endoscope processors encode."""
_GAIN: Span[float] = (0.7, 1.5)


def draw_subsurface(fwhm_m: Span[float], rng: np.random.Generator) -> Subsurface:
    """Draw how a tissue spreads light; the width of a Gaussian spot comes from a range."""
    kind, width = rng.random(), rng.uniform(*fwhm_m)
    scattering, absorption = (np.exp(rng.uniform(*np.log(span))) for span in (_REDUCED_SCATTERING_PER_M, _ABSORPTION_PER_M))
    if kind < _NONE:
        return Subsurface()
    if kind < _NONE + _DIPOLE:
        return Subsurface(profile="dipole", reduced_scattering_per_m=float(scattering), absorption_per_m=float(absorption))
    return Subsurface(profile="gaussian", fwhm_m=width)


def draw_response(rng: np.random.Generator) -> CameraResponse:
    """Draw how a camera encodes its signal."""
    encoded, gamma, gain = rng.random() < _ENCODED, rng.uniform(*_GAMMA), rng.uniform(*_GAIN)
    return CameraResponse(gain=gain, gamma=gamma) if encoded else CameraResponse()
