"""What holds for every network as an estimator."""

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, MissingFileError, WeightsError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.inference.models import random_module
from laploop.perception.network_specs import NETWORKS, SHIPPED
from laploop.perception.weights import save_weights

NAMES = [spec.name for spec in SHIPPED]


@pytest.fixture
def image():
    return np.random.default_rng(0).integers(0, 256, (128, 128), dtype=np.uint8)


@pytest.fixture
def tiny(small_rig, tmp_path):
    """Return a function that saves a tiny network with random weights, and gives it back with the path."""

    def make(name):
        network = random_module(name, small_rig, "tiny").network
        save_weights(tmp_path / "w.safetensors", network.state_dict(), network.config.architecture)
        return network.eval(), tmp_path / "w.safetensors"

    return make


@pytest.mark.parametrize("name", NAMES)
def test_estimator_of_a_file_says_what_the_network_says(name, small_rig, tiny, image):
    network, path = tiny(name)
    context = network.context(small_rig)
    with torch.inference_mode():
        output = network(torch.from_numpy(image.astype(np.float32))[None], *(() if context is None else (context,)))
    estimator = make_estimator(name, small_rig, path)
    assert isinstance(estimator, DepthEstimator)
    estimate = estimator.estimate(image)
    # Normalisations folded into convolutions: 2e-5 relative of at most 300 mm, more where turns are few.
    np.testing.assert_allclose(estimate.depth_mm, output.depth_mm[0].numpy(), rtol=1e-3, atol=0.02)
    np.testing.assert_array_equal(estimate.depth_mm, estimator.estimate(image).depth_mm)
    valid = {
        "slip_logit": lambda: output.valid(0.05)[0],
        "mask_logit": lambda: output.mask_logit[0] > 0.0,
        "latent": lambda: (output.depth_mm[0] >= 60.0) & (output.depth_mm[0] <= 140.0),
    }
    if hasattr(output, "slip_logit"):
        # A tenth: bfloat16 has 8 bits, and random weights make odds of any size.
        np.testing.assert_allclose(estimate.slip, torch.sigmoid(output.slip_logit)[0].numpy(), atol=0.1)
        assert (estimate.slip[estimate.valid] <= np.float32(0.05)).all()
    else:
        assert estimate.slip is None
    expected = next(rule() for field, rule in valid.items() if field in type(output).__dataclass_fields__)
    assert (estimate.valid == expected.numpy()).mean() > 0.999  # rounding may move a pixel across the border


@pytest.mark.parametrize("name", NAMES)
def test_other_images_and_other_rigs_are_refused(name, small_rig, tiny):
    _, path = tiny(name)
    estimator = make_estimator(name, small_rig, path)
    for image in (np.zeros((32, 128), np.uint8), np.zeros((128, 128), np.uint16), [[0]]):
        with pytest.raises(InvalidValueError, match="image"):
            estimator.estimate(image)
    with pytest.raises(InvalidValueError, match=r"height, width.*\(256, 256\); allowed: \(128, 128\)"):
        make_estimator(name, Rig.from_optics(ScopeOptics()), path)


@pytest.mark.parametrize("name", NAMES)
def test_missing_weights_say_how_to_train_them(name, rig, tmp_path):
    with pytest.raises(MissingFileError, match=r"w\.safetensors.*laploop train"):
        make_estimator(name, rig, tmp_path / "w.safetensors")


@pytest.mark.parametrize("name", NAMES)
def test_tensors_that_do_not_fit_their_description_are_refused(name, small_rig, tmp_path):
    path, spec = tmp_path / "w.safetensors", NETWORKS.get(name)
    save_weights(path, {}, spec.sized("tiny").for_image(128, 128).architecture)
    with pytest.raises(WeightsError, match="its tensors have other names, shapes or types"):
        make_estimator(name, small_rig, path)
