from dataclasses import replace

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.envs.loop.config import LoopConfig
from laploop.envs.sensors.optics.presets import optics_preset
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.errors import InvalidValueError
from laploop.perception.estimators.network import PhaseNetworkEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.inference.torch_runner import has_fast_bf16
from laploop.perception.networks.compact_unet import CompactUNet, Triangulation
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.networks.phase_reader import PhaseReading

SMALL = CompactConfig(widths=(8, 12, 16))
PLANE_MM = 90.0


@pytest.fixture
def network():
    torch.manual_seed(0)
    return CompactUNet(SMALL)


@pytest.fixture
def noise():
    return np.random.default_rng(0).integers(0, 256, (2, 256, 256)).astype(np.uint8)


def _tensor(images):
    return torch.from_numpy(np.asarray(images, dtype=np.float32))


def test_output_has_the_size_of_the_image_and_is_finite(rig, network, noise):
    output = network(_tensor(noise), network.context(rig))
    for name in ("turns", "depth_mm", "log_scale", "slip", "confidence"):
        values = getattr(output, name)
        assert values.shape == (2, 256, 256)
        assert torch.isfinite(values).all(), name


@pytest.mark.parametrize("value", [0.0, 255.0])
def test_black_and_white_images_give_finite_depth(rig, network, value):
    output = network.eval()(torch.full((1, 256, 256), value), network.context(rig))
    assert torch.isfinite(output.depth_mm).all()


def test_untrained_network_starts_as_the_classical_phase(rig, render):
    torch.manual_seed(0)
    network = CompactUNet(CompactConfig()).eval()
    with torch.inference_mode():
        network.reader.head.weight.zero_()
        network.reader.head.bias[4:8] = 20.0  # gate open
        image = _tensor(render(rig, np.full((256, 256), 1e-3 * PLANE_MM)))[None]
        error_mm = (network(image, network.context(rig)).depth_mm[0, :, 40:230] - PLANE_MM).abs()
    assert float(error_mm.max()) < 1.0


def test_gradients_reach_every_parameter(rig, network, noise):
    output = network(_tensor(noise), network.context(rig))
    (output.depth_mm.mean() + output.log_scale.mean() + output.confidence.mean()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert torch.isfinite(parameter.grad).all(), name
        assert parameter.grad.abs().sum() > 0.0, name


def test_fixed_front_end_is_not_stored_with_the_weights(network):
    assert not [name for name in network.state_dict() if name.startswith("front.")]


def test_same_seed_gives_the_same_weights():
    def make():
        torch.manual_seed(5)
        return CompactUNet(SMALL).state_dict()

    first, second = make(), make()
    assert all(torch.equal(first[name], second[name]) for name in first)


def reading(turns, log_scale, slip_logit):
    log_scale, slip_logit = (torch.as_tensor(values).expand_as(turns) for values in (log_scale, slip_logit))
    return PhaseReading(turns=turns, coarse_turns=turns, log_scale=log_scale, slip_logit=slip_logit)


def test_scale_in_millimetres_follows_the_slope_of_the_triangulation():
    metre = torch.tensor([[[0.0866]]])
    turns = metre / torch.tensor([[[0.07, 0.1, 0.13]]])
    output = Triangulation()(reading(turns, -5.0, 0.0), metre)
    step = 1e-4
    moved = Triangulation()(reading(turns - step, -5.0, 0.0), metre)
    slope = (moved.depth_mm - output.depth_mm) / step
    torch.testing.assert_close(output.log_scale.exp(), np.exp(-5.0) * slope, rtol=1e-2, atol=0.0)


def test_confidence_falls_with_the_scale_and_with_the_odds_of_a_slip():
    metre, turns = torch.tensor([[[0.0866]]]), torch.full((1, 1, 3), 0.9)
    scales = Triangulation()(reading(turns, [[[-6.0, -5.0, -4.0]]], -4.0), metre).confidence
    slips = Triangulation()(reading(turns, -5.0, [[[-4.0, 0.0, 4.0]]]), metre).confidence
    for confidence in (scales[0, 0], slips[0, 0]):
        assert confidence[0] > confidence[1] > confidence[2]


def test_folding_the_normalisation_changes_nothing(rig, network, noise):
    network.train()
    network(_tensor(noise), network.context(rig))  # moves the running statistics away from their start
    network.eval()
    with torch.inference_mode():
        before = network(_tensor(noise[:1]), network.context(rig)).depth_mm[0].numpy()
    depth_mm = PhaseNetworkEstimator(rig, network, precision="fp32").estimate(noise[0]).depth_mm
    np.testing.assert_allclose(depth_mm, before, rtol=1e-3)  # float32 rounding, amplified where turns are few


def test_same_image_gives_the_same_bits_whatever_was_seen_before(rig, network, noise):
    estimator = PhaseNetworkEstimator(rig, network)
    first = estimator.estimate(noise[0])
    estimator.estimate(noise[1])
    again = estimator.estimate(noise[0])
    np.testing.assert_array_equal(first.depth_mm, again.depth_mm)
    np.testing.assert_array_equal(first.valid, again.valid)
    np.testing.assert_array_equal(first.confidence, again.confidence)


def test_pixels_are_valid_within_the_working_range_where_a_slip_is_unlikely(rig, network, noise):
    with torch.inference_mode():
        output = network.eval()(_tensor(noise[:1]), network.context(rig))
    threshold = float(output.slip.median())
    estimate = PhaseNetworkEstimator(rig, network, max_slip=threshold, precision="fp32").estimate(noise[0])
    depth_mm = estimate.depth_mm
    wanted = (output.slip[0].numpy() <= threshold) & (depth_mm >= 60.0) & (depth_mm <= 140.0)
    assert 0.05 < wanted.mean() < 0.6
    # Folded normalisations round otherwise.
    assert (estimate.valid != wanted).mean() < 1e-3
    assert estimate.confidence.dtype == np.float32
    assert 0.0 <= estimate.confidence.min() <= estimate.confidence.max() <= 1.0


def test_one_network_serves_two_rigs(render):
    torch.manual_seed(0)
    network = CompactUNet(CompactConfig()).eval()
    other = Rig.from_optics(replace(ScopeOptics(), baseline_m=0.0042, mask=StripeMask(stripes=24, phase=0.3)))
    with torch.inference_mode():
        network.reader.head.weight.zero_()
        network.reader.head.bias[4:8] = 20.0
        image = _tensor(render(other, np.full((256, 256), 1e-3 * PLANE_MM)))[None]
        error_mm = (network(image, network.context(other)).depth_mm[0, :, 40:230] - PLANE_MM).abs()
    assert float(error_mm.max()) < 1.0


@pytest.mark.parametrize("image", [np.zeros((128, 128), np.uint8), np.zeros((256, 256), np.int32)])
def test_estimator_refuses_other_images(rig, network, image):
    with pytest.raises(InvalidValueError, match="image"):
        PhaseNetworkEstimator(rig, network).estimate(image)


@pytest.mark.parametrize(
    "change", [{"widths": (8,)}, {"widths": (2, 8)}, {"windows": ()}, {"windows": ((0.0, 1.0),)}, {"width": 200}]
)
def test_impossible_sizes_are_refused(change):
    with pytest.raises(InvalidValueError):
        CompactConfig(**change)


@pytest.mark.parametrize("options", [{"max_slip": -0.1}, {"max_slip": np.nan}, {"device": "tpu"}, {"device": "cuda:x"}])
def test_impossible_options_are_refused(rig, network, options):
    with pytest.raises(InvalidValueError, match=next(iter(options))):
        PhaseNetworkEstimator(rig, network, **options)


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
    assert 0.0 < apart_mm.mean() < 0.04
    assert np.percentile(apart_mm, 99) < 0.2
    assert (one.valid != other.valid).mean() < 0.003


def test_bfloat16_is_used_where_the_processor_has_it_and_no_other_is_known():
    rig = Rig.from_optics(ScopeOptics())
    assert make_estimator("compact", rig).precision == ("bf16" if has_fast_bf16() else "fp32")
    assert make_estimator("ssle-phase", rig).precision == "fp32"
    with pytest.raises(InvalidValueError, match="precision is 'fp16'"):
        make_estimator("compact", rig, arguments={"precision": "fp16"})
