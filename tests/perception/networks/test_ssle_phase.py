import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.carrier import StripeCarrier, gaussian_matrix
from laploop.perception.geometry import Rig
from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.ssle_phase import SslePhase, triangulate
from laploop.perception.networks.ssle_phase_front import (
    REFERENCE_M,
    PhaseFrontEnd,
    RigBatch,
    nearest_turn,
    rig_numbers,
    turn_back,
)

SIZE = 64
SMALL = SslePhaseConfig(height=SIZE, width=SIZE, reader_widths=(8, 12, 16), reader_fine_width=8, refiner_widths=(8, 12))
NOMINAL = ScopeOptics(width=SIZE, height=SIZE, mask=StripeMask(stripes=8))
OTHER = replace(
    NOMINAL,
    baseline_m=0.0042,
    fov_rad=math.radians(70.0),
    mask=StripeMask(stripes=6, phase=0.3, duty=0.45, fov_rad=math.radians(66.0)),
)


@pytest.fixture
def rigs():
    return [Rig.from_optics(NOMINAL), Rig.from_optics(OTHER)]


@pytest.fixture
def network():
    torch.manual_seed(0)
    return SslePhase(SMALL).eval()


def stripes(rig, depth_m):
    """Return the image that a rig with sinusoidal stripes takes of a facing plane, or of a depth map in metres."""
    carrier = StripeCarrier(rig=rig)
    turns = np.broadcast_to(carrier.turns_metre / np.asarray(depth_m), (rig.camera.height, rig.camera.width))
    return (100.0 + 50.0 * np.cos(carrier.angle - 2.0 * np.pi * turns)).astype(np.float32)


def test_front_end_has_the_carrier_and_the_windows_of_the_classical_method(rigs):
    front = PhaseFrontEnd((SIZE, SIZE), ((0.6, 2.0),))
    for index, rig in enumerate(rigs):
        carrier = StripeCarrier(rig=rig)
        batch = RigBatch.from_rigs(rigs)
        filters = front.prepare(batch)
        # Both are computed in double precision; the difference is rounding of some hundred radians.
        np.testing.assert_allclose(batch.angle(SIZE)[index, 0], carrier.angle, rtol=0, atol=1e-10)
        assert float(batch.turns_metre[index]) == pytest.approx(carrier.turns_metre, rel=1e-12)
        window = 2.0 * gaussian_matrix(SIZE, 0.6 * carrier.period_px).T
        np.testing.assert_allclose(filters.window_x[index, 0], window, rtol=0, atol=1e-6)  # float32


@pytest.mark.parametrize("depth_m", [0.062, 0.085, 0.110])
def test_triangulated_fraction_of_ideal_stripes_is_the_depth(rigs, depth_m):
    front = PhaseFrontEnd((SIZE, SIZE), ((0.6, 2.0),))
    batch = RigBatch.from_rigs(rigs)
    image = torch.from_numpy(np.stack([stripes(rig, depth_m) for rig in rigs]))
    seen = front(image, front.prepare(batch))
    expected = batch.turns_metre.float() / depth_m
    depth_mm = 1e3 * triangulate(nearest_turn(seen.fraction, expected), batch.turns_metre.float())
    # Away from the borders, where windows are cut; 1 % is what is left of the window's second harmonic.
    inner = slice(16, -16)
    np.testing.assert_allclose(depth_mm[:, inner, inner], 1e3 * depth_m, rtol=0.01)


def test_triangulation_is_the_rigs_own(rigs):
    depth_m = np.random.default_rng(0).uniform(0.05, 0.2, (SIZE, SIZE))
    for rig in rigs:
        projector_x = rig.projector_x(depth_m)
        turns = (rig.camera.rays[..., 0] - projector_x) / rig.mask.period_tan
        metre = RigBatch.from_rigs([rig]).turns_metre
        found = triangulate(torch.from_numpy(turns)[None], metre)[0]
        np.testing.assert_allclose(found, depth_m, rtol=1e-12)  # double precision
        np.testing.assert_allclose(found, rig.depth_from_projector_x(projector_x), rtol=1e-12)


def test_gradient_of_the_triangulation_is_right():
    turns = torch.linspace(0.4, 2.0, 7, dtype=torch.float64, requires_grad=True)
    metre = torch.tensor(0.0866, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(triangulate, (turns, metre))


def test_gradient_of_the_order_is_that_of_the_fraction():
    fraction = torch.linspace(-0.45, 0.45, 7, dtype=torch.float64, requires_grad=True)
    expected = torch.full((7,), 2.1, dtype=torch.float64)
    assert torch.autograd.gradcheck(nearest_turn, (fraction, expected))
    assert torch.all((nearest_turn(fraction, expected) - expected).abs() <= 0.5)


def test_turning_back_by_the_right_phase_leaves_a_real_positive_phasor():
    turns = torch.rand(1, 5, 7, dtype=torch.float64)
    angle = -2.0 * math.pi * turns
    products = torch.stack([torch.cos(angle), torch.sin(angle)], dim=1)
    left = turn_back(products, turns)
    torch.testing.assert_close(left[:, 0], torch.ones_like(turns))
    torch.testing.assert_close(left[:, 1], torch.zeros_like(turns))
    # To first order the imaginary part is minus 2 pi times what the turns lack.
    lacking = turn_back(products, turns - 1e-4)
    torch.testing.assert_close(lacking[:, 1], torch.full_like(turns, -2e-4 * math.pi), rtol=1e-3, atol=1e-9)


def test_loss_in_millimetres_reaches_every_weight_of_the_stage(rigs, network):
    network.train()
    image = torch.from_numpy(np.stack([stripes(rig, 0.08) for rig in rigs]))
    batch = RigBatch.from_rigs(rigs)
    filters = network.prepare(batch)
    reading = network.reader(network.see(image, filters), network.front, filters)
    (1e3 * triangulate(reading.turns, filters.turns_metre) - 90.0).abs().mean().backward()
    assert _without_gradient(network.reader) == []
    network.zero_grad()
    (network(image, batch).depth_mm - 90.0).abs().mean().backward()
    assert _without_gradient(network.refiner) == []
    assert all(weight.grad is None for weight in network.reader.parameters())


def _without_gradient(part):
    return [name for name, weight in part.named_parameters() if weight.grad is None or not weight.grad.abs().sum() > 0.0]


def test_batch_of_different_rigs_equals_single_ones(rigs, network):
    image = torch.from_numpy(np.stack([stripes(rig, 0.09) for rig in rigs]))
    with torch.inference_mode():
        together = network(image, RigBatch.from_rigs(rigs))
        for index, rig in enumerate(rigs):
            alone = network(image[index : index + 1], RigBatch.from_rigs([rig]))
            # Products of matrices are summed in another order: some units in the last place of float32.
            torch.testing.assert_close(together.depth_mm[index], alone.depth_mm[0], rtol=1e-4, atol=1e-2)
            torch.testing.assert_close(together.log_scale[index], alone.log_scale[0], rtol=1e-3, atol=1e-3)


def test_filters_made_once_give_what_rigs_give(rigs, network):
    image = torch.from_numpy(np.stack([stripes(rig, 0.09) for rig in rigs]))
    batch = RigBatch.from_rigs(rigs)
    with torch.inference_mode():
        assert torch.equal(network(image, network.prepare(batch)).depth_mm, network(image, batch).depth_mm)


def _read(network, rigs, depth_m):
    filters = network.prepare(RigBatch.from_rigs(rigs))
    seen = network.see(torch.from_numpy(np.stack([stripes(rig, depth_m) for rig in rigs])), filters)
    return seen, network.reader(seen, network.front, filters), filters


def test_untrained_reader_reads_the_classical_phase_on_any_rig(rigs, network):
    with torch.no_grad():
        network.reader.head.weight.zero_()
        network.reader.head.bias[4:8] = 20.0  # gate open
        network.reader.fine_head.weight.zero_()
        # An inner part of planes near the reference, where the turn is right without a coarse depth.
        _, reading, filters = _read(network, rigs, 0.088)
    depth_mm = 1e3 * triangulate(reading.turns, filters.turns_metre)
    np.testing.assert_allclose(depth_mm[:, 16:-16, 16:-16], 88.0, rtol=0.01)


def test_untrained_refiner_leaves_a_reading_as_it_is_but_for_its_gate(rigs, network):
    with torch.no_grad():
        network.refiner.head.weight.zero_()
        seen, reading, filters = _read(network, rigs, 0.1)
        ajar = network.refine(seen, reading.turns, reading.log_scale, filters)
        network.refiner.head.bias[4:8] = 20.0  # gate open
        output = network.refine(seen, reading.turns, reading.log_scale, filters)
    torch.testing.assert_close(output.turns, reading.turns)
    reference = filters.turns_metre / REFERENCE_M
    trust = 1.0 / (1.0 + math.exp(-3.0))
    torch.testing.assert_close(ajar.turns, trust * reading.turns + (1.0 - trust) * reference, rtol=1e-5, atol=1e-5)


def test_refiner_sees_the_same_whatever_the_number_of_stripes(network):
    # The same plane through two masks, read right: turned back, both sets of stripes are one constant.
    rigs = [Rig.from_optics(replace(NOMINAL, mask=StripeMask(stripes=stripe_count))) for stripe_count in (8, 12)]
    with torch.no_grad():
        seen, reading, filters = _read(network, rigs, 0.1)
        right = (filters.turns_metre / 0.1).expand_as(reading.turns)
        features = network.refiner._features(seen, right, reading.log_scale, network.front, filters)
    contrast = features[:, 33, 8:-8, 8:-8]  # the first window's, at half size
    sine = features[:, 32, 8:-8, 8:-8]
    assert float(sine.abs().max()) < 0.05
    torch.testing.assert_close(contrast[0], contrast[1], rtol=0.1, atol=0.0)


def test_scale_in_millimetres_follows_the_slope_of_the_triangulation(rigs, network):
    with torch.no_grad():
        for head in (network.reader.head, network.reader.fine_head, network.refiner.head):
            head.weight.zero_()
        output = network(torch.from_numpy(np.stack([stripes(rig, 0.09) for rig in rigs])), RigBatch.from_rigs(rigs))
    metre = RigBatch.from_rigs(rigs).turns_metre.float()
    wanted = torch.log(1e3 * math.exp(-4.0) * (1e-3 * output.depth_mm).square() / metre)
    torch.testing.assert_close(output.log_scale, wanted.clamp(-4.0, 4.0), rtol=1e-4, atol=1e-4)


def test_coarse_depth_of_an_untrained_reader_is_the_reference(rigs, network):
    with torch.no_grad():
        network.reader.head.weight.zero_()
        _, reading, filters = _read(network, rigs, 0.12)
    torch.testing.assert_close(reading.coarse_turns, (filters.turns_metre / REFERENCE_M).expand_as(reading.coarse_turns))


def test_drawn_mask_is_refused():
    rig = Rig.from_optics(replace(NOMINAL, mask=StripeMask(stripes=4, profile=(0.0, 1.0, 0.0, 1.0))))
    with pytest.raises(InvalidValueError, match="regular stripes"):
        rig_numbers(rig)


@pytest.mark.parametrize(
    "change",
    [
        {"reader_widths": (8,)},
        {"refiner_widths": (8, 2)},
        {"windows": ()},
        {"windows": ((0.0, 1.0),)},
        {"reader_fine_width": 2},
        {"height": 60},
        {"width": 0},
    ],
)
def test_impossible_sizes_are_refused(change):
    with pytest.raises(InvalidValueError):
        replace(SMALL, **change)


def test_rigs_of_the_wrong_shape_are_refused():
    with pytest.raises(InvalidValueError, match="batch"):
        RigBatch(values=torch.zeros(9))
