"""Anatomy scenes: what is where in the camera's view, and in what light."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.optics.subsurface import diffuse_reflectance
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig
from laploop.studies.scenes.anatomy_optics import AnatomyRanges, auto_exposed, draw_anatomy_optics, draw_materials
from laploop.studies.scenes.anatomy_scene import AnatomyScene, ToolPlacement
from laploop.studies.scenes.anatomy_views import draw_tools, draw_view

RANGES = AnatomyRanges(far_fraction=0.0)


@pytest.fixture(scope="module")
def camera():
    return StripeCamera(Rig.from_optics(ScopeOptics(width=64, height=64, mask=StripeMask(stripes=10))), threads=1)


@pytest.fixture(scope="module")
def scene(camera):
    rng = np.random.default_rng(1)
    scene = AnatomyScene("folds", "blood", draw_materials(RANGES, rng), rng)
    camera.attach_geometry(scene.geometry)
    return scene


def test_most_of_the_view_lies_in_the_range_of_the_loop(camera, scene):
    rng = np.random.default_rng(2)
    scene.place_tools([])
    fractions = []
    for _ in range(12):
        depth_mm = camera.exact(None, draw_view(RANGES, scene, camera, rng).world_from_camera).depth_mm
        assert np.nanmin(depth_mm) > 30.0
        fractions.append(np.mean((depth_mm >= 55.0) & (depth_mm <= 150.0)))
    assert np.median(fractions) > 0.6


def test_views_from_afar_lie_beyond_it(camera, scene):
    ranges = AnatomyRanges(far_fraction=1.0)
    distances = [draw_view(ranges, scene, camera, np.random.default_rng(k)).working_distance_m for k in range(10)]
    assert min(distances) >= 0.14


def test_drawn_tools_are_seen_and_leave_again(camera, scene):
    rng = np.random.default_rng(3)
    seen = []
    for _ in range(12):
        scene.place_tools([])
        pose = draw_view(RANGES, scene, camera, rng)
        before = camera.exact(None, pose.world_from_camera).object_id
        assert not (before == int(ObjectId.TOOL)).any()
        scene.place_tools(draw_tools(scene, camera, pose, rng))
        view = camera.exact(None, pose.world_from_camera)
        seen.append((view.object_id == int(ObjectId.TOOL)).mean())
        assert np.nanmin(view.depth_mm) > 5.0
    assert np.mean(np.array(seen) > 0.0) > 0.9
    assert max(seen) > 0.1


def test_tool_is_where_it_is_put(camera, scene):
    scene.place_tools([ToolPlacement(tip=np.array([0.0, 0.0, 0.30]), axis=np.array([0.0, 0.0, -1.0]))])
    from_below = np.eye(4)
    from_below[2, 3] = 0.25
    # The middle of the ball is 50 mm away.
    ball_mm = camera.exact(None, from_below).depth_mm[32, 32]
    assert ball_mm == pytest.approx(50.0 - 1e3 * scene.tip_radii_m[0], abs=0.1)
    scene.place_tools([])


def test_wet_places_have_the_material_of_the_film(camera, scene):
    scene.place_tools([])
    kinds = set(np.unique(scene.geometry.object_ids).tolist())
    assert kinds == {int(ObjectId.TISSUE), int(ObjectId.TOOL), int(ObjectId.OTHER)}
    materials = draw_materials(RANGES, np.random.default_rng(1))
    optics = draw_anatomy_optics(RANGES, materials, 0.09, np.random.default_rng(0))
    assert (optics.tissue, optics.other) == (materials.tissue, materials.film)
    assert materials.film.albedo == materials.tissue.albedo


def test_no_vertex_is_brighter_than_anything_in_a_body(scene):
    materials = draw_materials(RANGES, np.random.default_rng(1))
    assert materials.tissue.albedo * scene.geometry.albedo_factor.max() <= 0.9 + 1e-6


def test_albedos_span_liver_to_fat():
    albedos = [draw_materials(RANGES, np.random.default_rng(seed)).tissue.albedo for seed in range(200)]
    assert min(albedos) < 0.08
    assert max(albedos) > 0.65


def test_tissue_classes_tie_the_spread_of_light_to_the_albedo():
    ranges = replace(RANGES, tissue_class_fraction=1.0)
    for seed in range(20):
        tissue, usual = (draw_materials(each, np.random.default_rng(seed)).tissue for each in (ranges, RANGES))
        spread = tissue.subsurface
        assert spread.profile == "dipole"
        numbers = (spread.reduced_scattering_per_m, spread.absorption_per_m, spread.refractive_index)
        assert diffuse_reflectance(*numbers) == pytest.approx(tissue.albedo)
        # What a class does not decide is drawn as without.
        assert (tissue.reflectance, tissue.roughness) == (usual.reflectance, usual.roughness)


def test_automatic_exposure_meets_its_level(camera, scene):
    pose = draw_view(RANGES, scene, camera, np.random.default_rng(5))
    optics = replace(StripeOptics(), led_power_w=0.01)
    camera.set_optics(optics)
    exposed = auto_exposed(camera.capture(None, pose.world_from_camera, None), optics, 0.7)
    camera.set_optics(exposed)
    capture = camera.capture(None, pose.world_from_camera, None)
    bright = np.percentile(capture.electrons[capture.object_id != int(ObjectId.TOOL)], 95.0)
    assert bright / optics.full_well_electrons == pytest.approx(0.7, rel=1e-3)


def test_automatic_exposure_knows_the_response_of_the_camera(camera, scene):
    pose = draw_view(RANGES, scene, camera, np.random.default_rng(5))
    optics = replace(StripeOptics(), response=CameraResponse(gain=1.3, gamma=2.2))
    camera.set_optics(optics)
    camera.set_optics(auto_exposed(camera.capture(None, pose.world_from_camera, None), optics, 0.7))
    capture = camera.capture(None, pose.world_from_camera, None)
    grey = np.percentile(capture.image[capture.object_id != int(ObjectId.TOOL)], 95.0)
    assert grey / 255.0 == pytest.approx(0.7, abs=0.01)


def test_ranges_out_of_order_are_refused():
    with pytest.raises(InvalidValueError, match="far_distance_m"):
        AnatomyRanges(far_distance_m=(0.05, 0.2))
