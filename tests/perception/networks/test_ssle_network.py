from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.configs import LatentUNetConfig, SsleConfig, VqVaeConfig
from laploop.perception.networks.latent_unet import LatentUNet
from laploop.perception.networks.residual_blocks import ResidualBlock, SelfAttention
from laploop.perception.networks.ssle_network import SsleNetwork
from laploop.perception.networks.vq_vae import (
    Decoder,
    Encoder,
    VqVae,
    depth_to_unit,
    image_to_unit,
    unit_to_depth,
)

PAPER = VqVaeConfig()
SSLE = NETWORKS.get("ssle")


def parameter_count(module):
    return sum(parameter.numel() for parameter in module.parameters())


def _gmac(module, *shape):
    with FlopCounterMode(display=False) as counter:
        module(torch.empty(*shape, device="meta"))
    return counter.get_total_flops() / 2e9


def test_papers_encoder_has_the_published_parameters_operations_and_latent():
    with torch.device("meta"):
        encoder = Encoder(PAPER)
    assert encoder(torch.empty(1, 1, 256, 256, device="meta")).shape == (1, 64, 128, 128)
    assert parameter_count(encoder) / 1e6 == pytest.approx(1.45, abs=0.005)
    assert _gmac(encoder, 1, 1, 256, 256) == pytest.approx(99.6, abs=0.05)


def test_attention_in_the_middle_costs_what_its_matrices_say():
    with torch.device("meta"):
        attending, plain = Encoder(PAPER), Encoder(VqVaeConfig(attention=False))
    products = 2 * (128 * 128) ** 2 * 128 / 1e9  # queries with keys, and weights with values
    projections = 4 * 128 * 128 * 128 * 128 / 1e9
    difference = _gmac(attending, 1, 1, 256, 256) - _gmac(plain, 1, 1, 256, 256)
    assert difference == pytest.approx(products + projections, rel=1e-3)
    assert products == pytest.approx(68.7, abs=0.05)


def test_papers_decoder_is_the_reference_frameworks_less_a_block_a_level_with_a_transposed_convolution():
    with torch.device("meta"):
        decoder = Decoder(PAPER)
    assert decoder(torch.empty(1, 64, 128, 128, device="meta")).shape == (1, 1, 256, 256)
    # The framework's, 2.04 M and 122.4 GMAC, has three blocks a level and enlarges by repetition and a 3x3 convolution.
    blocks = 2 * (9 * 128 * 128 + 128) + 4 * 128 + 2 * (9 * 64 * 64 + 64) + 4 * 64
    enlarging = (9 - 16) * 128 * 128
    assert (parameter_count(decoder) + blocks + enlarging) / 1e6 == pytest.approx(2.04, abs=0.005)
    work = 2 * 9 * 128 * 128 * 128**2 + 2 * 9 * 64 * 64 * 256**2 + 9 * 128 * 128 * 256**2 - 16 * 128 * 128 * 128**2
    assert _gmac(decoder, 1, 64, 128, 128) + work / 1e9 == pytest.approx(122.4, abs=0.05)


def test_papers_unet_has_the_published_parameters_and_operations():
    with torch.device("meta"):
        unet = LatentUNet(64, 64, LatentUNetConfig())
    side = sum(width * 128 + 128 for width in (512, 256, 128))
    assert LatentUNetConfig().widths == (128, 256, 512, 1024, 1024)
    assert (parameter_count(unet) - side) / 1e6 == pytest.approx(69.1, abs=0.05)
    assert _gmac(unet, 1, 64, 128, 128) == pytest.approx(41.2, abs=0.15)  # GMAC; the side heads are 0.12 of it


def test_whole_paper_network_can_be_described_without_memory():
    with torch.device("meta"):
        network = SsleNetwork(SSLE.sized("paper"))
    learned = parameter_count(network) - network.depth_quantizer.codebook.numel()
    # 72.6 M with the framework's decoder, which has 0.26 M more, and without the side heads' 0.11 M.
    assert learned / 1e6 == pytest.approx(72.6 - 0.26 + 0.11, abs=0.06)


def test_side_heads_start_without_any_influence():
    torch.manual_seed(0)
    unet = LatentUNet(3, 2, LatentUNetConfig(base=8, multipliers=(1, 2, 2))).eval()
    x = torch.randn(1, 3, 16, 16)
    before = unet(x)
    torch.nn.init.normal_(unet.side[0].weight)
    after = unet(x)
    assert before.shape == (1, 2, 16, 16)
    assert not torch.equal(before, after)
    torch.nn.init.zeros_(unet.side[0].weight)
    assert torch.equal(unet(x), before)


def test_attention_is_softmax_of_scaled_products():
    torch.manual_seed(1)
    layer = SelfAttention(8).double()
    x = torch.randn(2, 8, 3, 4, dtype=torch.float64)
    query, key, value = layer.qkv(layer.norm(x)).flatten(2).chunk(3, dim=1)
    weights = torch.softmax(torch.einsum("bci,bcj->bij", query, key) / 8**0.5, dim=-1)
    mixed = torch.einsum("bij,bcj->bci", weights, value).reshape(2, 8, 3, 4)
    torch.testing.assert_close(layer(x), x + layer.out(mixed))


def test_layers_have_the_gradients_of_finite_differences():
    torch.manual_seed(2)
    block, attention = ResidualBlock(4, 6).double(), SelfAttention(6).double()
    x = torch.randn(1, 4, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda value: attention(block(value)), (x,))


def test_decoder_stays_in_the_range_of_tanh_and_mirrors_the_encoders_size():
    torch.manual_seed(3)
    config = VqVaeConfig(base=8, multipliers=(1, 2, 2), blocks=1, attention=True, latent=4, entries=16)
    decoded, quantized = VqVae(config)(torch.rand(1, 1, 32, 24))
    assert decoded.shape == (1, 1, 32, 24)
    assert quantized.values.shape == (1, 4, 8, 6)
    assert decoded.abs().max() <= 1.0


def test_folding_keeps_every_pixel_and_the_layers_at_full_size_away():
    torch.manual_seed(3)
    config = VqVaeConfig(fold=4, base=8, multipliers=(1, 2), blocks=1, attention=False, latent=4, entries=16)
    network = VqVae(config)
    image = torch.rand(1, 1, 32, 24)
    decoded, quantized = network(image)
    assert config.shrink == 8
    assert decoded.shape == (1, 1, 32, 24)
    assert quantized.values.shape == (1, 4, 4, 3)
    folded = network.encoder.layers[0](image)
    assert folded.shape == (1, 16, 8, 6)
    torch.testing.assert_close(folded[0, :, 2, 1].reshape(4, 4), image[0, 0, 8:12, 4:8])


def test_estimate_from_codes_is_that_from_the_image():
    torch.manual_seed(6)
    network = SsleNetwork(SSLE.sized("tiny").for_image(32, 32)).eval()
    image = torch.rand(2, 32, 32) * 255.0
    indices = network.quantizer.lookup(network.encoder(image_to_unit(image)))
    depth_mm = network.from_codes(network.quantizer.decode(indices)).depth_mm
    # mm; the quantiser's way around the gradient rounds once more.
    torch.testing.assert_close(depth_mm, network(image).depth_mm, rtol=0.0, atol=1e-2)


def test_depth_range_maps_to_tanhs_and_back():
    depth = torch.tensor([[[0.0, 125.0, 250.0, float("nan"), 400.0]]])
    unit = depth_to_unit(depth, 250.0)
    assert unit.flatten().tolist() == [-1.0, 0.0, 1.0, 1.0, 1.0]
    assert unit_to_depth(unit, 250.0).flatten().tolist() == [0.0, 125.0, 250.0, 250.0, 250.0]
    assert image_to_unit(torch.tensor([[[0.0, 255.0]]])).flatten().tolist() == [-1.0, 1.0]


def test_quantizing_the_predicted_latent_leaves_codebook_entries_only():
    torch.manual_seed(4)
    tiny = SSLE.sized("tiny").for_image(32, 32)
    network = SsleNetwork(tiny).eval()
    image = torch.rand(1, 32, 32) * 255.0
    plain = network(image)
    quantizing = SsleNetwork(replace(tiny, quantize_depth=True)).eval()
    quantizing.load_state_dict(network.state_dict())
    torch.testing.assert_close(quantizing(image).latent, plain.latent)
    entries = network.depth_quantizer(plain.latent).values
    torch.testing.assert_close(quantizing(image).depth_mm, unit_to_depth(network.decoder(entries), 250.0))


def test_standardised_latent_is_scaled_back_for_the_decoder():
    torch.manual_seed(5)
    network = SsleNetwork(SSLE.sized("tiny").for_image(32, 32)).eval()
    network.latent_mean.fill_(0.5)
    network.latent_deviation.fill_(2.0)
    output = network(torch.rand(1, 32, 32) * 255.0)
    torch.testing.assert_close(output.depth_mm, unit_to_depth(network.decoder(2.0 * output.latent + 0.5), 250.0))
    torch.testing.assert_close(network.standardize(2.0 * output.latent + 0.5), output.latent)


@pytest.mark.parametrize("size", SSLE.sizes)
def test_every_named_size_fits_its_parts_together(size):
    with torch.device("meta"):
        network = SsleNetwork(SSLE.sized(size)).eval()
    assert network(torch.empty(1, 256, 256, device="meta")).depth_mm.shape == (1, 256, 256)


def test_unknown_size_is_refused_and_the_known_ones_are_listed():
    with pytest.raises(UnknownNameError, match="paper, small, tiny"):
        SSLE.sized("huge")


@pytest.mark.parametrize(
    "change", [{"height": 250}, {"image": VqVaeConfig(multipliers=(1, 2, 2))}, {"farthest_mm": 0.0}, {"width": 0}]
)
def test_parts_that_do_not_fit_are_refused(change):
    with pytest.raises(InvalidValueError):
        SsleConfig(**change)


@pytest.mark.parametrize("change", [{"base": 2}, {"multipliers": ()}, {"blocks": 0}, {"latent": 0}])
def test_impossible_vq_vae_is_refused(change):
    with pytest.raises(InvalidValueError):
        VqVaeConfig(**change)
