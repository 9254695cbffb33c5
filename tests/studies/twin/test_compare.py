import importlib.util

import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.studies.twin import render
from laploop.studies.twin.compare import SceneComparison, compare_with_twin
from laploop.studies.twin.figure import draw_twin
from laploop.studies.twin.render import aperture_points, check_mitsuba
from laploop.studies.twin.scene import plane_scene


def test_points_fill_the_aperture_evenly():
    points = aperture_points(2.0, 61)
    assert points.shape == (61, 2)
    radius = np.linalg.norm(points, axis=1)
    assert radius.max() < 2.0
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
    # A uniform disk has half of its squared radius as the mean square.
    assert np.mean(radius**2) == pytest.approx(2.0, rel=0.02)


def test_edges_that_were_shifted_are_found_by_how_far():
    x = np.arange(256) + 0.5
    wave = np.tile(1000.0 * (1.0 + 0.5 * np.sin(2.0 * np.pi * x / 12.8)), (3, 1))
    moved = np.tile(1000.0 * (1.0 + 0.5 * np.sin(2.0 * np.pi * (x - 0.2) / 12.8)), (3, 1))
    offsets = SceneComparison(scene=plane_scene(80), camera=moved, twin=wave).edge_offsets_px(12.8)
    assert len(offsets) > 100
    assert np.median(offsets) == pytest.approx(0.2, abs=0.01)


def test_without_mitsuba_the_extra_is_named(monkeypatch):
    monkeypatch.setattr(render.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InvalidValueError, match=r"laploop\[twin\]"):
        check_mitsuba()


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="needs the extra 'twin'")
def test_the_stripe_camera_makes_the_path_tracers_image(tmp_path):
    found = compare_with_twin()
    ours, theirs = found.contrasts.T
    np.testing.assert_allclose(ours, theirs, rtol=0.02)
    for compared in (*found.planes, *found.scenes, found.shadow):
        assert compared.brightness == pytest.approx(1.0, abs=0.02), compared.scene.name
    for compared in found.scenes:
        offsets = np.abs(compared.edge_offsets_px(found.period_px))
        assert len(offsets) > 2000, compared.scene.name
        assert np.median(offsets) < 0.1, compared.scene.name
        assert np.percentile(offsets, 95) < 0.3, compared.scene.name
    ours_px, theirs_px = found.penumbra_px
    assert theirs_px > 2.0
    assert ours_px == pytest.approx(theirs_px, rel=0.05)
    draw_twin(found, "title", tmp_path / "twin.png")
    assert (tmp_path / "twin.png").read_bytes().startswith(b"\x89PNG")
