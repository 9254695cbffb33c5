from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import minimum_filter, uniform_filter

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.scenes.frame_conditions import FrameRanges, draw_camera
from laploop.studies.scenes.hard_conditions import ill_exposure, place_large_tool
from laploop.studies.scenes.training_scene import TrainingScene
from laploop.studies.synthesis.config import TrainingFramesConfig
from laploop.studies.synthesis.run import render_training_frames

OPTICS = ScopeOptics(width=64, height=64, mask=StripeMask(stripes=10))
TINY = TrainingFramesConfig(
    train_tissues=0, val_tissues=0, test_tissues=1, frames_per_tissue=4, tool_share=0.0, workers=1, optics=OPTICS
)


def _render(folder, **changes):
    return FrameStore.open(render_training_frames(replace(TINY, **changes), folder / "frames"))


def test_only_tissues_that_were_drawn_have_patches_and_nothing_else_changes(tmp_path):
    plain, bloody = (_render(tmp_path / name, randomised_appearances=float(name)) for name in ("0", "1"))
    assert [replace(TINY, randomised_appearances=0.0).appearance_of(tissue).is_plain for tissue in range(3)] == [True] * 3
    np.testing.assert_array_equal(plain.depth_mm(0), bloody.depth_mm(0))
    assert plain.image(0).mean() > bloody.image(0).mean() + 1.0


def test_tenth_to_half_of_the_pixels_are_saturated_or_dark_in_turn(tmp_path):
    store = _render(tmp_path, ill_exposed_share=1.0)
    for index in range(len(store)):
        image = store.image(index)
        useless = (image >= 253).mean() if index % 2 == 0 else (image <= 8).mean()
        assert 0.07 < useless < 0.60  # noise and rounding move some pixels across the threshold


def test_data_set_may_hold_frames_without_shading(tmp_path):
    usual, bare = (_render(tmp_path / name, tool_share=0.0, unshaded_share=float(name)) for name in ("0", "1"))
    for index in range(len(bare)):
        np.testing.assert_array_equal(bare.depth_mm(index), usual.depth_mm(index))
        seen = minimum_filter(bare.lit(index), 15)
        # Averaged over four periods, what is left of the stripes is all but even.
        usual_mean, bare_mean = (uniform_filter(store.image(index).astype(float), 13)[seen] for store in (usual, bare))
        assert np.std(bare_mean) / np.mean(bare_mean) < 0.4 * np.std(usual_mean) / np.mean(usual_mean)


def test_exposure_puts_the_wanted_share_beyond_the_threshold():
    electrons = np.linspace(1.0, 5000.0, 10_000, dtype=np.float32).reshape(100, 100)
    optics = StripeOptics()
    for saturated in (True, False):
        changed = ill_exposure(electrons, optics, 0.3, saturated=saturated)
        grey = 255.0 * electrons * changed.led_power_w / optics.led_power_w / optics.full_well_electrons
        share = (grey >= 253.0).mean() if saturated else (grey <= 8.0).mean()
        assert share == pytest.approx(0.3, abs=0.001)


def test_large_tool_covers_nearly_a_third_of_the_view():
    rng = np.random.default_rng(0)
    scene, camera = TrainingScene(TissueConfig(), rng), StripeCamera(Rig.from_optics(OPTICS), threads=1)
    camera.attach(scene.model, tissue=scene.tissue, rng=rng)
    shares = [place_large_tool(scene, camera, draw_camera(FrameRanges(), scene.mean_height_m, rng), rng) for _ in range(3)]
    assert np.mean(shares) >= 0.28  # where 40 tries do not reach 30 %, the best of them stays


def test_data_set_may_hold_large_tools(tmp_path):
    store = _render(tmp_path, tool_share=1.0, large_tool_share=1.0)
    assert store.tool_in_view.all()
    assert np.mean([(store.depth_mm(index) < 45.0).mean() for index in range(len(store))]) > 0.2


def test_scopes_are_drawn_a_tissue_and_always_the_same():
    config = replace(TINY, train_tissues=40, randomised_scopes=0.5)
    scopes = [config.scope_of(tissue) for tissue in range(40)]
    nominal = sum(scope == OPTICS for scope in scopes)
    assert 10 <= nominal <= 30
    assert len({(scope.baseline_m, scope.mask.stripes) for scope in scopes}) == 41 - nominal
    assert scopes == [config.scope_of(tissue) for tissue in range(40)]


def test_frames_of_drawn_scopes_obey_their_own_rig(tmp_path):
    store = _render(tmp_path, test_tissues=2, frames_per_tissue=1, randomised_scopes=1.0)
    assert store.rig(0) != store.rig(1)
    for index in range(2):
        rig = store.rig(index)
        mask_x = rig.projector_x(1e-3 * store.depth_mm(index).astype(np.float64))[store.lit(index)]
        assert np.abs(mask_x).max() <= rig.mask.half_width_tan + 1e-5  # tangent; float32 depth
        assert np.abs(mask_x).max() > 0.8 * rig.mask.half_width_tan


@pytest.mark.parametrize(
    "name", ["randomised_scopes", "randomised_appearances", "large_tool_share", "ill_exposed_share", "unshaded_share"]
)
def test_share_beyond_one_is_refused(name):
    with pytest.raises(InvalidValueError, match=name):
        replace(TINY, **{name: 1.5})
