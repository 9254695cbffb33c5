"""Images in which brightness tells nothing of distance and slope, so that depth can come from the stripes alone."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.envs.sensors.stripe_camera import StripeCamera


def unshaded_image(camera: StripeCamera, data: Any, world_from_camera: Array, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Take an image with its shading divided out, as bright in the mean as with it and as noisy as a pixel of that charge is.

    The shading is what the projector gives when its optics scatter all of its light evenly over the field: it has no stripes,
    but fall-off, slopes, shadows, texture and gloss as before.

    Args:
        camera: Keeps its optics.
        data: As for `StripeCamera.capture`.
        world_from_camera: 4x4, computer-vision camera.
        rng: Source of the noise.

    Returns:
        Grey values, (height, width).
    """
    optics = camera.optics
    striped = camera.capture(data, world_from_camera, None).electrons.astype(np.float64)
    camera.set_optics(replace(optics, glare_fraction=1.0))
    shading = camera.capture(data, world_from_camera, None).electrons.astype(np.float64)
    camera.set_optics(optics)
    stripes = np.divide(striped, shading, out=np.zeros_like(striped), where=shading > 0.0)
    expected = stripes * (striped.mean() / max(float(stripes.mean()), 1e-9))
    charge = expected + np.sqrt(expected + optics.read_noise_electrons**2) * rng.standard_normal(expected.shape)
    signal = np.maximum(optics.response.gain * charge / optics.full_well_electrons, 0.0) ** (1.0 / optics.response.gamma)
    return np.asarray(np.clip(np.rint(255.0 * signal), 0.0, 255.0), dtype=np.uint8)
