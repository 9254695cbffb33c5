import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.loop.config import LoopConfig
from laploop.envs.sensors.optics.presets import optics_preset
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.errors import InvalidValueError
from laploop.perception.estimators.network import ScaleEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.inference.torch_runner import has_fast_bf16
from laploop.perception.networks.compact_unet import CompactUNet
from laploop.perception.networks.configs import CompactConfig

SMALL = CompactConfig(widths=(8, 12, 16))


@pytest.fixture
def network(rig):
    torch.manual_seed(0)
    return CompactUNet(rig, SMALL)


def _images(count=2, size=256):
    return torch.from_numpy(np.random.default_rng(0).uniform(0, 255, (count, size, size)).astype(np.float32))


def test_output_has_the_size_of_the_image_and_is_finite(network):
    output = network(_images())
    assert output.depth_mm.shape == output.log_scale.shape == output.turns.shape == (2, 256, 256)
    assert all(torch.isfinite(value).all() for value in (output.depth_mm, output.log_scale, output.turns))


def test_latent_is_half_the_size_of_the_image(network):
    features, base = network.front(_images())
    assert features.shape == (2, network.front.channels, 128, 128)
    assert base.shape == (2, 256, 256)


@pytest.mark.parametrize("value", [0.0, 255.0])
def test_black_and_white_images_give_finite_depth(network, value):
    output = network.eval()(torch.full((1, 256, 256), value))
    assert torch.isfinite(output.depth_mm).all()


def test_front_end_reads_the_phase_of_a_plane(rig, render):
    depth = np.full((256, 256), 0.09)
    front = CompactUNet(rig, CompactConfig()).front
    _, base = front(torch.from_numpy(render(rig, depth).astype(np.float32))[None])
    turns = rig.baseline_m / rig.mask.period_tan / 0.09
    inside = base[0, :, 40:230]
    assert float((inside - turns).abs().max()) < 0.01  # turns; 1 mm at 90 mm


def test_untrained_network_starts_near_the_classical_phase(rig, render):
    torch.manual_seed(0)
    network = CompactUNet(rig, CompactConfig()).eval()
    image = torch.from_numpy(render(rig, np.full((256, 256), 0.09)).astype(np.float32))[None]
    with torch.inference_mode():
        error = (network(image).depth_mm[0, :, 60:200] - 90.0).abs()
    assert float(error.mean()) < 8.0  # mm; the gate is open at 0.88 only


def test_gradients_reach_every_parameter(network):
    output = network(_images())
    (output.depth_mm.mean() + output.log_scale.mean()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().sum() > 0.0, name


def test_fixed_front_end_is_not_stored_with_the_weights(network):
    assert not [name for name in network.state_dict() if name.startswith("front.")]


def test_same_seed_gives_the_same_weights(rig):
    def make():
        torch.manual_seed(5)
        return CompactUNet(rig, SMALL).state_dict()

    first, second = make(), make()
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_folding_the_normalisation_changes_nothing(rig):
    torch.manual_seed(0)
    network = CompactUNet(rig, SMALL)
    network.train()
    network(_images())  # moves the running statistics away from their start
    network.eval()
    image = np.random.default_rng(1).integers(0, 256, (256, 256)).astype(np.uint8)
    with torch.inference_mode():
        before = network(torch.from_numpy(image.astype(np.float32))[None]).depth_mm[0].numpy()
    depth_mm = ScaleEstimator(rig, network).estimate(image).depth_mm
    np.testing.assert_allclose(depth_mm, before, rtol=1e-3)  # float32 rounding, amplified where turns are few


def test_same_image_gives_the_same_bits_whatever_was_seen_before(rig, network):
    estimator = ScaleEstimator(rig, network)
    rng = np.random.default_rng(2)
    image, other = rng.integers(0, 256, (2, 256, 256)).astype(np.uint8)
    first = estimator.estimate(image)
    estimator.estimate(other)
    again = estimator.estimate(image)
    np.testing.assert_array_equal(first.depth_mm, again.depth_mm)
    np.testing.assert_array_equal(first.valid, again.valid)


def test_pixels_are_valid_where_the_predicted_scale_is_small_enough(rig, network):
    image = np.random.default_rng(3).integers(0, 256, (256, 256)).astype(np.uint8)
    with torch.inference_mode():
        scale_mm = network.eval()(torch.from_numpy(image.astype(np.float32))[None]).log_scale.exp()
    threshold = float(scale_mm.median())
    estimate = ScaleEstimator(rig, network, max_scale_mm=threshold).estimate(image)
    assert 0.4 < estimate.valid.mean() < 0.6
    assert estimate.depth_mm.dtype == np.float32


@pytest.mark.parametrize("image", [np.zeros((128, 128), np.uint8), np.zeros((256, 256), np.int32)])
def test_estimator_refuses_other_images(rig, network, image):
    with pytest.raises(InvalidValueError, match="image"):
        ScaleEstimator(rig, network).estimate(image)


def test_size_that_cannot_be_halved_often_enough_is_refused():
    rig = Rig.from_optics(ScopeOptics(width=200, height=200))
    with pytest.raises(InvalidValueError, match="multiples of 32"):
        CompactUNet(rig, CompactConfig())


@pytest.mark.parametrize("change", [{"widths": (8,)}, {"widths": (2, 8)}, {"windows": ()}, {"windows": ((0.0, 1.0),)}])
def test_impossible_sizes_are_refused(change):
    with pytest.raises(InvalidValueError):
        CompactConfig(**change)


@pytest.mark.parametrize("options", [{"max_scale_mm": 0.0}, {"max_scale_mm": np.nan}, {"device": "tpu"}, {"device": "cuda:x"}])
def test_impossible_options_are_refused(rig, network, options):
    with pytest.raises(InvalidValueError, match=next(iter(options))):
        ScaleEstimator(rig, network, **options)


@pytest.mark.parametrize("preset", ["paper", "worst"])
def test_bfloat16_changes_the_depth_by_hundredths_of_a_millimetre(preset):
    env = ReachEnv(ReachConfig(observation_mode="stripes", loop=LoopConfig(optics=optics_preset(preset))), perception="oracle")
    rig = env.loop.rig
    exact, lowered = (make_estimator("compact", rig, arguments={"precision": precision}) for precision in ("fp32", "bf16"))
    image = env.reset(seed=2)[0]["stripes"]
    env.close()
    one, other = exact.estimate(image), lowered.estimate(image)
    both = one.valid & other.valid
    apart_mm = np.abs(one.depth_mm - other.depth_mm)[both]
    assert 0.0 < apart_mm.mean() < 0.02
    assert np.percentile(apart_mm, 99) < 0.1
    assert (one.valid != other.valid).mean() < 0.003


def test_bfloat16_is_used_where_the_processor_has_it_and_no_other_is_known():
    rig = Rig.from_optics(ScopeOptics())
    assert make_estimator("compact", rig).precision == ("bf16" if has_fast_bf16() else "fp32")
    assert make_estimator("ssle-phase", rig).precision == "fp32"
    with pytest.raises(InvalidValueError, match="precision is 'fp16'"):
        make_estimator("compact", rig, arguments={"precision": "fp16"})
