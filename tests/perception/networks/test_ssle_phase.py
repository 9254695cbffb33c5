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
from laploop.perception.networks.band import along_rows
from laploop.perception.networks.configs import CompactConfig, SslePhaseConfig
from laploop.perception.networks.phase_front import REFERENCE_M, PhaseFrontEnd, RigBatch, rig_numbers, turn_back
from laploop.perception.networks.ssle_phase import SslePhase
from laploop.perception.networks.stripe_order import choose_order, triangulate

SIZE = 64
SMALL = SslePhaseConfig(reader=CompactConfig(height=SIZE, width=SIZE, widths=(8, 12, 16)), refiner_widths=(8, 12))
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
        found = along_rows(torch.eye(SIZE), filters.window_x)
        np.testing.assert_allclose(found[index, 0], window, rtol=0, atol=1e-6)  # float32


@pytest.mark.parametrize("depth_m", [0.062, 0.085, 0.110])
def test_triangulated_fraction_of_ideal_stripes_is_the_depth(rigs, depth_m):
    front = PhaseFrontEnd((SIZE, SIZE), ((0.6, 2.0),))
    batch = RigBatch.from_rigs(rigs)
    image = torch.from_numpy(np.stack([stripes(rig, depth_m) for rig in rigs]))
    seen = front(image, front.prepare(batch))
    metre = batch.turns_metre.float()
    depth_mm = 1e3 * triangulate(choose_order(seen.fraction, metre / depth_m, metre), metre)
    # Away from the borders, where windows are cut; 1 % is what is left of the window's second harmonic.
    inner = slice(16, -16)
    np.testing.assert_allclose(depth_mm[:, inner, inner], 1e3 * depth_m, rtol=0.01)


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


def test_loss_in_millimetres_reaches_every_weight_of_the_refiner_and_none_of_the_reader(rigs, network):
    network.train()
    image = torch.from_numpy(np.stack([stripes(rig, 0.08) for rig in rigs]))
    output = network(image, RigBatch.from_rigs(rigs))
    ((output.depth_mm - 90.0).abs() + output.log_scale + output.slip_logit).mean().backward()
    assert _without_gradient(network.refiner) == []
    assert all(weight.grad is None for weight in network.compact.parameters())


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
    seen = network.compact.see(torch.from_numpy(np.stack([stripes(rig, depth_m) for rig in rigs])), filters)
    return seen, network.compact.read(seen, filters), filters


def test_untrained_refiner_leaves_a_reading_as_it_is_but_for_its_gate(rigs, network):
    with torch.no_grad():
        network.refiner.head.weight.zero_()
        seen, reading, filters = _read(network, rigs, 0.1)
        ajar = network.refine(seen, reading, filters)
        network.refiner.head.bias[4:8] = 20.0  # gate open
        output = network.refine(seen, reading, filters)
    torch.testing.assert_close(output.turns, reading.turns)
    torch.testing.assert_close(output.slip_logit, reading.slip_logit)
    reference = filters.turns_metre / REFERENCE_M
    trust = 1.0 / (1.0 + math.exp(-3.0))
    torch.testing.assert_close(ajar.turns, trust * reading.turns + (1.0 - trust) * reference, rtol=1e-5, atol=1e-5)


def test_refiner_sees_the_same_whatever_the_number_of_stripes(network):
    # The same plane through two masks, read right: turned back, both sets of stripes are one constant.
    rigs = [Rig.from_optics(replace(NOMINAL, mask=StripeMask(stripes=stripe_count))) for stripe_count in (8, 12)]
    with torch.no_grad():
        seen, reading, filters = _read(network, rigs, 0.1)
        right = replace(reading, turns=(filters.turns_metre / 0.1).expand_as(reading.turns))
        features = network.refiner._features(seen, right, network.compact.front, filters)
    contrast = features[:, 34, 8:-8, 8:-8]  # the first window's, at half size
    sine = features[:, 33, 8:-8, 8:-8]
    assert float(sine.abs().max()) < 0.05
    torch.testing.assert_close(contrast[0], contrast[1], rtol=0.1, atol=0.0)


def test_coarse_depth_of_an_untrained_reader_is_the_reference(rigs, network):
    with torch.no_grad():
        network.compact.reader.head.weight.zero_()
        _, reading, filters = _read(network, rigs, 0.12)
    torch.testing.assert_close(reading.coarse_turns, (filters.turns_metre / REFERENCE_M).expand_as(reading.coarse_turns))


def test_drawn_mask_is_refused():
    rig = Rig.from_optics(replace(NOMINAL, mask=StripeMask(stripes=4, profile=(0.0, 1.0, 0.0, 1.0))))
    with pytest.raises(InvalidValueError, match="regular stripes"):
        rig_numbers(rig)


@pytest.mark.parametrize(
    "change",
    [
        {"refiner_widths": (8,)},
        {"refiner_widths": (8, 2)},
        {"reader": CompactConfig(height=72, width=72, widths=(8, 12, 16))},
    ],
)
def test_impossible_sizes_are_refused(change):
    with pytest.raises(InvalidValueError):
        replace(SMALL, **change)


def test_rigs_of_the_wrong_shape_are_refused():
    with pytest.raises(InvalidValueError, match="batch"):
        RigBatch(values=torch.zeros(9))
