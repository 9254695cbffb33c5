"""A stripe camera in closed form, so that perception is tested without the simulator."""

import numpy as np
import pytest
from scipy.special import erf

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.geometry import Rig


@pytest.fixture(scope="session")
def rig():
    return Rig.from_optics(ScopeOptics())


@pytest.fixture(scope="session")
def small_rig():
    """A quarter of the pixels with half the stripes, for networks that must train in seconds."""
    return Rig.from_optics(ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10)))


@pytest.fixture(scope="session")
def render():
    """Return a function that draws what a rig's camera sees of a depth map (H, W) in metres."""

    def draw(rig, depth_m, *, rng=None, bright=150.0, dark=15.0, blur_periods=0.16, albedo=1.0):
        mask = rig.mask
        position = (rig.projector_x(depth_m) + mask.half_width_tan) / mask.period_tan - mask.phase
        whole = np.floor(position)
        width = blur_periods * np.sqrt(2.0)
        wave = sum(
            0.5 * (erf((position - whole - k) / width) - erf((position - whole - k - mask.duty) / width)) for k in (-1, 0, 1)
        )
        lit = (position > 0.0) & (position < mask.stripes)
        grey = albedo * (dark + (bright - dark) * wave * lit)
        if rng is not None:
            electrons_per_grey = 10_500.0 / 255.0
            grey = rng.poisson(np.maximum(grey, 0.0) * electrons_per_grey) / electrons_per_grey
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)

    return draw


@pytest.fixture(scope="session")
def sphere_depth():
    """Return a function that gives the depth of a ball in front of a plane, and where the ball is seen."""

    def depth(rig, *, centre_m=(0.004, -0.006, 0.1), radius_m=0.03, plane_m=0.11):
        rays = rig.camera.rays
        centre = np.array(centre_m)
        along = rays @ centre
        square = np.sum(rays**2, axis=-1)
        inside = along**2 - square * (centre @ centre - radius_m**2)
        hit = inside > 0.0
        return np.where(hit, (along - np.sqrt(np.maximum(inside, 0.0))) / square, plane_m), hit

    return depth
