import importlib.util
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.subsurface import Subsurface
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.studies.twin import render
from laploop.studies.twin.compare import SceneComparison, compare_with_twin, fold_lines, line_profile, width_at
from laploop.studies.twin.figure import draw_twin
from laploop.studies.twin.light import digitised, lights
from laploop.studies.twin.render import aperture_points, check_mitsuba, render_twin
from laploop.studies.twin.scene import SPOT_SPACING_PX, fold_scene, plane_scene, twin_optics
from laploop.studies.twin.spread import SpotProfile, dipole, spread


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


def _lines(of_place):
    x = np.arange(256) + 0.5
    return sum(of_place(x - 128.3 - SPOT_SPACING_PX * n) for n in range(-2, 3))


@pytest.mark.parametrize("sigma", [1.0, 2.0, 5.0])
def test_lines_of_a_known_profile_have_its_widths(sigma):
    place, light = fold_lines(_lines(lambda x: 300.0 * np.exp(-0.5 * (x / sigma) ** 2)), SPOT_SPACING_PX)
    assert len(place) == round(5 * SPOT_SPACING_PX)
    # Five samples a pixel: half a fifth of a pixel off the peak costs 0.5 % of the narrowest.
    assert width_at(place, light, 0.5) == pytest.approx(2.0 * sigma * np.sqrt(2.0 * np.log(2.0)), rel=0.005)
    assert width_at(place, light, 0.1) == pytest.approx(2.0 * sigma * np.sqrt(2.0 * np.log(10.0)), rel=0.005)
    assert np.sum(light) == pytest.approx(5.0)


def test_each_line_counts_alike_and_places_are_millimetres_on_the_surface():
    rows = np.tile(_lines(lambda x: (1.0 + 0.002 * x) * (np.abs(x) < 4.05)), (9, 1))
    place_mm, light = line_profile(rows)
    pixel_mm = 2.0 * 70.0 * np.tan(np.radians(30.0)) / 256
    assert width_at(place_mm, light, 0.5) == pytest.approx(8.1 * pixel_mm, abs=0.2 * pixel_mm)


def test_the_judges_dipole_has_a_spot_like_that_of_the_cameras_gaussians():
    tissue = Subsurface(profile="dipole", reduced_scattering_per_m=1000.0, absorption_per_m=150.0)
    radius = np.linspace(0.0, 0.03, 3001)
    exact = dipole(radius**2, 1000.0, 150.0, tissue.refractive_index)
    exact /= np.trapezoid(2.0 * np.pi * radius * exact, radius)
    fitted = sum(w / (2.0 * np.pi * s**2) * np.exp(-0.5 * (radius / s) ** 2) for w, s in tissue.gaussians)
    assert fitted[0] == pytest.approx(exact[0], rel=0.04)
    for level in (0.5, 0.1):
        exact_m, fitted_m = (radius[np.argmax(spot < level * spot[0])] for spot in (exact, fitted))
        assert fitted_m == pytest.approx(exact_m, rel=0.04)
    reach_m = SpotProfile.of(tissue).reach_m
    beyond = radius > reach_m
    assert np.trapezoid(2.0 * np.pi * radius[beyond] * exact[beyond], radius[beyond]) < 1e-3


@pytest.mark.parametrize("subsurface", [Subsurface(profile="gaussian", fwhm_m=0.001), Subsurface(profile="dipole")])
def test_a_point_of_light_spreads_as_the_profile_says_and_none_is_lost(subsurface):
    rig = Rig.from_optics(ScopeOptics(width=64, height=64))
    z = 0.02
    position = z * rig.camera.rays
    light = np.zeros((64, 64))
    light[32, 32] = 1.0
    facing, everywhere = np.full((64, 64, 3), [0.0, 0.0, -1.0]), np.full((64, 64), True)
    found = spread(light, everywhere, position, facing, rig.camera.rays, subsurface, rig)
    # Weights are normalised at each pixel by what its own neighbours add up to.
    assert found.sum() == pytest.approx(1.0, abs=0.02)
    profile = SpotProfile.of(subsurface)
    square = np.sum((position - position[32, 32]) ** 2, axis=-1)
    near = square < (0.5 * profile.reach_m) ** 2
    np.testing.assert_allclose(found[near] / found[32, 32], profile.at(square)[near] / profile.at(square)[32, 32], rtol=0.02)


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
    (card, *tissues) = found.spot_widths_mm
    for ours_mm, theirs_mm in np.concatenate(tissues):
        assert ours_mm == pytest.approx(theirs_mm, rel=0.05)
    # The lens's point spreads have the same variance, and what is finer than they are has another shape.
    np.testing.assert_allclose(*card.T, rtol=0.1)
    assert [row["profile"] for row in found.as_dict()["spot"]] == ["none", "gaussian", "dipole"]
    draw_twin(found, "title", tmp_path / "twin.png")
    assert (tmp_path / "twin.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(importlib.util.find_spec("mitsuba") is None, reason="needs the extra 'twin'")
def test_a_path_of_several_bounces_is_brighter_in_a_fold_and_as_bright_on_a_plane():
    rig, optics = Rig.from_optics(ScopeOptics()), twin_optics()

    def brightness(scene):
        camera = StripeCamera(rig, optics)
        camera.attach_geometry(scene.geometry)
        view = camera.exact(None, np.eye(4))
        camera.close()
        options = {"rows": (124, 132), "points": 7}
        direct = render_twin(rig, optics, scene.geometry, view, **options)
        return render_twin(rig, optics, scene.geometry, view, bounces=3, **options).mean() / direct.mean()

    assert brightness(plane_scene(80)) == pytest.approx(1.0, abs=0.005)
    assert 1.02 < brightness(fold_scene()) < 1.4


def test_grey_values_follow_the_response_and_the_noise():
    optics = replace(twin_optics(), response=CameraResponse(gamma=2.0))
    electrons = np.full((300, 300), 0.25 * optics.full_well_electrons)
    grey = digitised(electrons, optics, np.random.default_rng(0))
    assert grey.mean() == pytest.approx(127.5, abs=0.3)
    linear = digitised(electrons, twin_optics(), np.random.default_rng(0)).astype(np.float64)
    noise = np.sqrt(electrons[0, 0] + optics.read_noise_electrons**2) / optics.full_well_electrons * 255.0
    assert linear.std() == pytest.approx(np.hypot(noise, 12.0**-0.5), rel=0.02)


def test_lights_differ_from_the_nominal_one():
    nominal, *others = lights()
    for light in others:
        assert light.optics != nominal.optics or light.bounces > 1 or light.vessels, light.name
