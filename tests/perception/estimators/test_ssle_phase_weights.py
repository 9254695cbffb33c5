import math
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.estimators import make_estimator
from laploop.perception.geometry import Rig

WIDE = math.radians(66.0)
SCOPES = {
    "nominal": ScopeOptics(),
    "shifted": ScopeOptics(mask=StripeMask(phase=0.4)),
    "short baseline": ScopeOptics(baseline_m=0.0042),
    "fine stripes": ScopeOptics(mask=StripeMask(stripes=26, phase=0.7)),
    "wide, coarse stripes": ScopeOptics(fov_rad=WIDE, baseline_m=0.0054, mask=StripeMask(stripes=16, fov_rad=WIDE)),
}


def _estimate(rig, render, depth_m):
    image = render(rig, depth_m, rng=np.random.default_rng(0), blur_periods=0.22)
    return make_estimator("ssle-phase", rig).estimate(image)


def _surface(rig):
    """Return a gently rolling surface at 75 to 95 mm, the same one whatever the field of view, (H, W) in metres."""
    x, y = rig.camera.rays[..., 0], rig.camera.rays[..., 1]
    return 0.085 + 0.006 * np.sin(5.0 * x + 0.3) * np.cos(4.0 * y) + 0.004 * np.sin(7.0 * y)


@pytest.mark.parametrize("name", SCOPES)
def test_same_surface_is_found_through_any_scope(render, name):
    rig = Rig.from_optics(SCOPES[name])
    depth_m = _surface(rig)
    estimate = _estimate(rig, render, depth_m)
    assert estimate.valid.mean() > 0.6
    error = np.abs(estimate.depth_mm - 1e3 * depth_m)[estimate.valid]
    assert error.mean() < 0.8  # mm; the picture is simpler than those it has learned from
    assert np.quantile(error, 0.99) < 5.0  # a wrong stripe order would be off by 50 mm and more


def test_geometry_is_really_an_input(render):
    rig = Rig.from_optics(SCOPES["nominal"])
    depth_m = _surface(rig)
    image = render(rig, depth_m, rng=np.random.default_rng(0), blur_periods=0.22)
    told_wrong = make_estimator("ssle-phase", replace(rig, baseline_m=0.9 * rig.baseline_m)).estimate(image)
    ratio = np.median((told_wrong.depth_mm / (1e3 * depth_m))[told_wrong.valid])
    assert ratio == pytest.approx(0.9, abs=0.02)  # the same phase over a shorter baseline is a nearer surface


def test_black_image_has_no_valid_pixel():
    estimate = make_estimator("ssle-phase", Rig.from_optics(ScopeOptics())).estimate(np.zeros((256, 256), np.uint8))
    assert estimate.valid.mean() < 0.01
    assert np.isfinite(estimate.depth_mm).all()
