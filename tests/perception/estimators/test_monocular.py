import sys

import numpy as np
import pytest

from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError, WeightsError
from laploop.perception.estimators.monocular import FARTHEST_MM, MODELS, MonocularEstimator, fitted
from laploop.perception.estimators.registry import ESTIMATORS, make_estimator


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Two tiny networks with random weights, saved as published ones are."""
    import torch
    from transformers import DepthAnythingConfig, DepthAnythingForDepthEstimation, DPTConfig, DPTForDepthEstimation

    torch.manual_seed(0)
    neck = {"neck_hidden_sizes": [8, 8, 8, 8], "fusion_hidden_size": 8}
    dpt = DPTConfig(
        hidden_size=16,
        num_hidden_layers=4,
        num_attention_heads=2,
        intermediate_size=32,
        image_size=64,
        backbone_out_indices=[0, 1, 2, 3],
        **neck,
    )
    backbone = {
        "model_type": "dinov2",
        "image_size": 56,
        "hidden_size": 16,
        "num_hidden_layers": 4,
        "num_attention_heads": 2,
        "out_indices": [1, 2, 3, 4],
        "reshape_hidden_states": False,
    }
    anything = DepthAnythingConfig(backbone_config=backbone, reassemble_hidden_size=16, head_hidden_size=4, **neck)
    out = tmp_path_factory.mktemp("models")
    DPTForDepthEstimation(dpt).save_pretrained(out / "dpt")
    DepthAnythingForDepthEstimation(anything).save_pretrained(out / "depth-anything")
    return {name: out / name for name in MODELS}


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(0, 256, (256, 256), dtype=np.uint8)


@pytest.mark.parametrize("name", list(MODELS))
def test_network_from_a_local_folder_gives_finite_depth_in_the_range_the_same_each_time(rig, folders, image, name):
    estimator = make_estimator(name, rig, folders[name])
    estimate = estimator.estimate(image)
    assert estimate.depth_mm.shape == (256, 256)
    assert estimate.valid.all()
    assert 60.0 <= estimate.depth_mm.min() < estimate.depth_mm.max() <= 140.001  # mm, single precision
    np.testing.assert_array_equal(estimate.depth_mm, estimator.estimate(image).depth_mm)


@pytest.mark.parametrize("name", list(MODELS))
def test_network_sees_the_normalised_image_at_its_own_size(rig, folders, name):
    """A grey plane is the same at any size, so that the input is known in closed form."""
    estimator = make_estimator(name, rig, folders[name])
    seen = {}
    network = estimator._network
    estimator._network = lambda pixel_values: seen.update(pixels=pixel_values) or network(pixel_values=pixel_values)
    estimator.relative_inverse_depth(np.full((256, 256), 51, np.uint8))
    side = {"dpt": 64, "depth-anything": 56}[name]
    assert tuple(seen["pixels"].shape) == (1, 3, side, side)
    for channel in range(3):
        expected = (0.2 - MODELS[name].mean[channel]) / MODELS[name].deviation[channel]
        np.testing.assert_allclose(seen["pixels"][0, channel].numpy(), expected, atol=1e-5)


def test_fit_finds_scale_and_shift_and_ignores_what_is_masked():
    rng = np.random.default_rng(0)
    truth = rng.uniform(60.0, 140.0, (32, 32)).astype(np.float32)
    relative = (1.0 / truth.astype(np.float64) - 0.002) / 3e-4
    mask = rng.random(truth.shape) < 0.6
    spoiled = np.where(mask, truth, np.nan).astype(np.float32)
    np.testing.assert_allclose(fitted(relative, spoiled, mask).depth_mm[mask], truth[mask], rtol=1e-5)


def test_fit_is_the_best_in_inverse_depth():
    rng = np.random.default_rng(1)
    truth = rng.uniform(60.0, 140.0, (32, 32)).astype(np.float32)
    relative = 1.0 / truth + rng.normal(0.0, 1e-3, truth.shape)
    everywhere = np.ones(truth.shape, bool)
    scale, shift = np.polyfit(relative.ravel(), 1.0 / truth.ravel(), 1)
    np.testing.assert_allclose(1.0 / fitted(relative, truth, everywhere).depth_mm, scale * relative + shift, rtol=1e-4)


def test_fitted_depth_stays_in_front_of_the_camera():
    relative = np.linspace(-5.0, 5.0, 64).reshape(8, 8)
    truth = np.full((8, 8), 100.0, np.float32)
    truth[-1] = 60.0
    depth = fitted(relative, truth, np.ones((8, 8), bool)).depth_mm
    assert depth.min() > 0.0
    assert depth.max() <= FARTHEST_MM


def test_nothing_to_fit_is_refused():
    with pytest.raises(InvalidValueError, match="pixels to fit"):
        fitted(np.ones((4, 4)), np.ones((4, 4), np.float32), np.zeros((4, 4), bool))
    with pytest.raises(InvalidValueError, match="shapes"):
        fitted(np.ones((4, 4)), np.ones((4, 5), np.float32), np.zeros((4, 4), bool))


def test_baselines_are_no_perception_for_the_loop():
    assert not set(MODELS) & set(ESTIMATORS.names())


def test_model_that_is_not_at_hand_is_named_with_what_fetches_it(rig, tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path / "cache"))
    with pytest.raises(MissingFileError, match="hf download Intel/dpt-large"):
        make_estimator("dpt", rig)
    with pytest.raises(MissingFileError, match="nowhere"):
        make_estimator("dpt", rig, tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(MissingFileError, match="empty"):
        make_estimator("depth-anything", rig, tmp_path / "empty")


def test_missing_transformers_says_which_extra_brings_it(rig, folders, monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(MissingFileError, match=r"laploop\[monocular\]"):
        make_estimator("dpt", rig, folders["dpt"])


def test_model_of_another_kind_and_unknown_name_are_refused(rig, folders):
    with pytest.raises(WeightsError, match="depth_anything"):
        make_estimator("dpt", rig, folders["depth-anything"])
    with pytest.raises(UnknownNameError, match="depth-anything, dpt"):
        MonocularEstimator.from_pretrained(rig, name="midas")


def test_weights_that_are_incomplete_damaged_or_pickled_are_refused(rig, folders, tmp_path):
    import shutil

    from safetensors.numpy import load_file, save_file

    for kind in ("incomplete", "damaged", "pickled"):
        shutil.copytree(folders["dpt"], tmp_path / kind)
    tensors = load_file(folders["dpt"] / "model.safetensors")
    del tensors[next(name for name in tensors if name.startswith("head."))]
    save_file(tensors, tmp_path / "incomplete" / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(WeightsError, match="lacks 1 weights"):
        make_estimator("dpt", rig, tmp_path / "incomplete")
    (tmp_path / "damaged" / "model.safetensors").write_bytes(b"\x10\x00\x00\x00\x00\x00\x00\x00not weights at all")
    with pytest.raises(WeightsError, match="damaged"):
        make_estimator("dpt", rig, tmp_path / "damaged")
    (tmp_path / "pickled" / "model.safetensors").rename(tmp_path / "pickled" / "pytorch_model.bin")
    with pytest.raises(MissingFileError, match="safetensors"):
        make_estimator("dpt", rig, tmp_path / "pickled")


def test_wrong_image_and_impossible_range_are_refused(rig, folders):
    estimator = make_estimator("dpt", rig, folders["dpt"])
    with pytest.raises(InvalidValueError, match="shape of image"):
        estimator.estimate(np.zeros((64, 64), np.uint8))
    with pytest.raises(InvalidValueError, match="range_mm"):
        MonocularEstimator(rig, estimator._network, MODELS["dpt"], range_mm=(140.0, 60.0))
