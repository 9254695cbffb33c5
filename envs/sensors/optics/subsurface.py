"""How light spreads under a surface before it leaves again, as a sum of Gaussians."""

import functools
import math
from typing import Annotated, Literal

import numpy as np
from scipy.optimize import brentq, least_squares, nnls

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

_FWHM_PER_SIGMA = math.sqrt(8.0 * math.log(2.0))
_DIPOLE_GAUSSIANS = 3
_ABSORPTIONS_PER_M = (1.0, 1e4)

SpotWidth = Annotated[float, Field(ge=0.0, le=0.02)]


@configuration
class Subsurface:
    """The spot that a point of light makes on a surface from below; its integral is 1, as albedo says how much comes back.

    `gaussian` is one Gaussian of a given width. `dipole` is the diffuse part of Jensen et al. (A Practical Model for Subsurface
    Light Transport, SIGGRAPH 2001): two sources of light, one below the surface and one above, in a medium that is as deep and
    wide as needed. Only mu_s' = mu_s (1 - g) enters: the anisotropy g has no effect of its own.
    """

    profile: Literal["none", "gaussian", "dipole"] = "none"
    """How light spreads under the surface: not at all, as a Gaussian, or as a dipole in a turbid medium."""
    fwhm_m: SpotWidth = 0.001
    """Full width at half maximum of `gaussian`."""
    reduced_scattering_per_m: Annotated[float, Field(ge=50.0, le=1e5)] = 1000.0
    """mu_s' of `dipole`: about 1 per millimetre in soft tissue in the visible."""
    absorption_per_m: Annotated[float, Field(ge=_ABSORPTIONS_PER_M[0], le=_ABSORPTIONS_PER_M[1])] = 150.0
    """mu_a of `dipole`: 0.05 to 0.5 per millimetre in soft tissue in the visible, most where there is most blood."""
    refractive_index: Annotated[float, Field(ge=1.0, le=2.0)] = 1.37
    """Of the medium of `dipole`, against air; 1.37 is that of tissue with 70 to 85 % water."""

    @property
    def gaussians(self) -> tuple[tuple[float, float], ...]:
        """Weights, which add up to 1, and standard deviations in metres, ascending."""
        if self.profile == "none":
            return ((1.0, 0.0),)
        if self.profile == "gaussian":
            return ((1.0, self.fwhm_m / _FWHM_PER_SIGMA),)
        return _fitted_gaussians(self.reduced_scattering_per_m, self.absorption_per_m, self.refractive_index)


def dipole_transfer(frequency: Array, scattering: float, absorption: float, index: float) -> Array:
    """Return the modulation transfer of the dipole, 1 at zero, at frequencies in radians per metre, of any shape.

    A source at the depth z gives the reflectance z (1 + k d) exp(-k d) / (4 pi d^3) at the distance d from it, k^2 being
    3 mu_a mu_t'. Its Hankel transform is exp(-z sqrt(q^2 + k^2)) / 2 at the frequency q.
    """
    sources = _sources(frequency, scattering, absorption, index)
    return sources / _sources(0.0, scattering, absorption, index)


def diffuse_reflectance(scattering: float, absorption: float, index: float) -> float:
    """Return how much of the light that enters a medium leaves it again, by the dipole of Jensen et al. (2001)."""
    reduced_albedo = scattering / (scattering + absorption)
    return 0.5 * reduced_albedo * float(_sources(0.0, scattering, absorption, index))


def absorption_of(albedo: float, scattering: float, index: float) -> float:
    """Return the absorption per metre with which a medium of that reduced scattering has that diffuse reflectance.

    Raises:
        InvalidValueError: If the albedo is outside of what the dipole gives for absorptions of 1 to 1e4 per metre.
    """
    low, high = _ABSORPTIONS_PER_M
    brightest, darkest = (diffuse_reflectance(scattering, absorption, index) for absorption in (low, high))
    if not darkest <= albedo <= brightest:
        raise InvalidValueError("albedo", albedo, f"{darkest:.3g} to {brightest:.3g} with that scattering")
    return float(brentq(lambda absorption: diffuse_reflectance(scattering, absorption, index) - albedo, low, high))


def _sources(frequency: Array | float, scattering: float, absorption: float, index: float) -> Array:
    """Return the sum of both sources' transforms, each 1 at their own depth of zero."""
    transport = scattering + absorption
    # Diffuse Fresnel reflectance inside the surface, by the rational fit that Jensen et al. give.
    inner = -1.440 / index**2 + 0.710 / index + 0.668 + 0.0636 * index
    boundary = (1.0 + inner) / (1.0 - inner)
    depth = 1.0 / transport
    mirrored = depth * (1.0 + 4.0 / 3.0 * boundary)
    decay = math.sqrt(3.0 * absorption * transport)
    rate = np.sqrt(np.square(frequency) + decay**2)
    return np.asarray(np.exp(-depth * rate) + np.exp(-mirrored * rate))


@functools.lru_cache(maxsize=64)
def _fitted_gaussians(scattering: float, absorption: float, index: float) -> tuple[tuple[float, float], ...]:
    """Fit the dipole's modulation transfer from 30 mm to 0.3 mm of wavelength, by Gaussians whose weights add up to 1."""
    frequency = 2.0 * math.pi / np.geomspace(0.03, 0.0003, 96)
    wanted = dipole_transfer(frequency, scattering, absorption, index)
    total = 10.0

    def weights_of(log_sigma: Array) -> tuple[Array, Array]:
        basis = np.exp(-0.5 * (np.exp(log_sigma) * frequency[:, None]) ** 2)
        # The last row makes the weights add up to 1 to within a thousandth; scaling does the rest.
        weights, _ = nnls(np.vstack([basis, np.full(len(log_sigma), total)]), np.append(wanted, total))
        weights /= weights.sum()
        return weights, basis @ weights - wanted

    path = 1.0 / (scattering + absorption)
    reach = 1.0 / math.sqrt(3.0 * absorption * (scattering + absorption))
    start = np.log(np.geomspace(0.3 * path, max(reach, 2.0 * path), _DIPOLE_GAUSSIANS))
    found = least_squares(lambda log_sigma: weights_of(log_sigma)[1], start)
    order = np.argsort(found.x)
    weights, _ = weights_of(found.x[order])
    return tuple((float(w), float(s)) for w, s in zip(weights, np.exp(found.x[order]), strict=True) if w > 0.0)
