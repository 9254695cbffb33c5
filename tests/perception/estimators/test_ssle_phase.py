import numpy as np
import pytest
import torch
from laploop.perception.estimators.ssle_phase import SslePhaseEstimator

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, MissingFileError, WeightsError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig
from laploop.perception.networks.ssle_phase import SslePhase, SslePhaseConfig
from laploop.perception.networks.ssle_phase_front import RigBatch
from laploop.perception.weights import save_weights


@pytest.fixture
def network():
    torch.manual_seed(0)
    return SslePhase(SslePhaseConfig())


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(0, 256, (256, 256), dtype=np.uint8)


def test_estimator_says_what_the_network_says(rig, network, image):
    network.eval()
    with torch.inference_mode():
        output = network(torch.from_numpy(image.astype(np.float32))[None], RigBatch.from_rigs([rig]))
        expected = output.depth_mm[0].numpy().copy()
    estimator = SslePhaseEstimator(rig, network)
    assert isinstance(estimator, DepthEstimator)
    depth_mm, scale_mm = estimator.estimate_with_scale(image)
    np.testing.assert_allclose(depth_mm, expected, atol=0.02)  # mm; normalisation folded into convolutions, float32
    estimate = estimator.estimate(image)
    np.testing.assert_array_equal(estimate.depth_mm, depth_mm)
    np.testing.assert_array_equal(estimate.valid, scale_mm <= 2.0)


def test_weights_that_were_written_are_read_back(rig, network, image, tmp_path):
    path = tmp_path / "w.safetensors"
    save_weights(path, network.state_dict(), network.config.architecture)
    again = SslePhaseEstimator.from_weights(rig, path)
    np.testing.assert_array_equal(again.estimate(image).depth_mm, SslePhaseEstimator(rig, network).estimate(image).depth_mm)


def test_missing_weights_say_how_to_train_them(rig, tmp_path):
    with pytest.raises(MissingFileError, match="laploop train --model ssle-phase"):
        SslePhaseEstimator.from_weights(rig, tmp_path / "w.safetensors")


def test_weights_of_another_size_are_refused(rig, tmp_path):
    other = SslePhase(SslePhaseConfig(reader_widths=(8, 16)))
    save_weights(tmp_path / "w.safetensors", other.state_dict(), other.config.architecture)
    with pytest.raises(WeightsError, match="architecture"):
        SslePhaseEstimator.from_weights(rig, tmp_path / "w.safetensors")


def test_rig_with_another_image_size_is_refused(network):
    with pytest.raises(InvalidValueError, match=r"\(128, 128\)"):
        SslePhaseEstimator(Rig.from_optics(ScopeOptics(width=128, height=128)), network)


def test_threshold_must_be_positive(rig, network):
    with pytest.raises(InvalidValueError, match="max_scale_mm"):
        SslePhaseEstimator(rig, network, max_scale_mm=0.0)
