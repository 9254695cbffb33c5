import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.perception.networks.ssle_phase import SslePhaseConfig, SslePhaseOutput
from laploop.perception.networks.ssle_phase_front import rig_numbers
from laploop.perception.training.recipe import Schedule
from laploop.perception.training.samples import Samples, stack
from laploop.perception.training.ssle_phase import SslePhaseRecipe, SslePhaseTraining, ssle_phase_loss, train_ssle_phase

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
WIDER = replace(
    OPTICS, baseline_m=0.0055, fov_rad=math.radians(66.0), mask=StripeMask(stripes=12, phase=0.4, fov_rad=math.radians(66.0))
)
NETWORK = SslePhaseConfig(height=128, width=128, widths=(16, 32), refine_width=16)
SCHEDULE = Schedule(epochs=24, batch=2, learning_rate=4e-3, final_learning_rate=1e-5, per_step=True, warmup_steps=4)
TRAINING = SslePhaseTraining(schedule=SCHEDULE, gain_range=0.0)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, render):
    """Eight frames of gently rolling surfaces, seen by two scopes in turn, and two to validate on."""
    rng = np.random.default_rng(0)
    store = FrameStore.create(
        tmp_path_factory.mktemp("rigs") / "frames",
        optics=OPTICS,
        scopes=[OPTICS, WIDER],
        scope=np.arange(10, dtype=np.int32) % 2,
        tissue_seed=np.arange(10),
        split=np.array([0] * 8 + [1] * 2, np.uint8),
        tool_in_view=np.zeros(10, bool),
        config={},
    )
    x, y = np.meshgrid(np.linspace(-1, 1, 128), np.linspace(-1, 1, 128))
    for index in range(10):
        a, b, c = rng.uniform(0.0, 2.0 * np.pi, 3)
        depth_m = rng.uniform(0.08, 0.11) + 0.005 * np.sin(3 * x + a) * np.cos(2 * y + b) + 0.003 * np.sin(4 * y + c)
        image = render(store.rig(index), depth_m, rng=rng)
        store.write(index, image=image, depth_mm=(1e3 * depth_m).astype(np.float32), lit=np.ones((128, 128), bool))
    return FrameStore.open(store.path)


def _output(depth, log_scale, coarse, first):
    return SslePhaseOutput(turns=depth, depth_mm=depth, log_scale=log_scale, coarse_mm=coarse, first_mm=first)


def test_loss_is_likelihood_errors_and_the_coarse_logarithm():
    depth, log_scale = torch.tensor([[[100.0, 90.0]]]), torch.tensor([[[0.0, 1.0]]])
    truth = torch.tensor([[[103.0, 85.0]]])
    first, coarse = torch.tensor([[[104.0, 85.0]]]), torch.tensor([[[103.0, 85.0 * math.e]]])
    training = replace(TRAINING, l1_weight=0.5, coarse_weight=2.0)
    loss = ssle_phase_loss(_output(depth, log_scale, coarse, first), truth, training)
    by_hand = 0.5 * ((3.0 + 0.0 + 0.5 * (3.0 + 1.0)) + (5.0 / math.e + 1.0 + 0.5 * (5.0 + 0.0) + 2.0 * 1.0))
    assert float(loss.total) == pytest.approx(by_hand, rel=1e-6)
    assert float(loss.parts["mae_mm"]) == pytest.approx(4.0)


def test_pixels_without_truth_have_no_influence():
    depth = torch.full((1, 2, 2), 100.0, requires_grad=True)
    fixed = torch.full((1, 2, 2), 100.0)
    truth = torch.tensor([[[101.0, float("nan")], [5.0, 900.0]]])
    ssle_phase_loss(_output(depth, torch.zeros(1, 2, 2), fixed, fixed), truth, TRAINING).total.backward()
    assert torch.isfinite(depth.grad).all()
    assert torch.count_nonzero(depth.grad) == 1


def test_sample_brings_the_rig_of_its_frame(dataset):
    recipe = SslePhaseRecipe(NETWORK, TRAINING)
    samples = Samples.read(dataset, "train", recipe)
    batch = stack([recipe.augment(samples.rows[row], np.random.default_rng(row)) for row in range(2)])
    assert batch["rig"].dtype == torch.float64
    for row, optics in enumerate((OPTICS, WIDER)):
        assert tuple(batch["rig"][row].tolist()) == rig_numbers(Rig.from_optics(optics))


def test_short_training_overfits_eight_frames_of_two_rigs_to_under_a_millimetre(dataset):
    recipe = SslePhaseRecipe(NETWORK, TRAINING)
    batch = stack(Samples.read(dataset, "train", recipe).rows)
    optimizer = torch.optim.Adam(recipe.parameters())
    before = float(_errors_mm(recipe, batch).mean())
    for step in range(96):
        for group in optimizer.param_groups:
            group["lr"] = SCHEDULE.rate(step, 4)
        rows = slice(2 * (step % 4), 2 * (step % 4) + 2)
        optimizer.zero_grad()
        recipe.loss({name: value[rows] for name, value in batch.items()}, step / 96).total.backward()
        optimizer.step()
    after = _errors_mm(recipe, batch)
    assert after.mean() < 1.0  # mm, over all pixels, those beyond the lit field included
    assert after.mean() < 0.3 * before


def test_command_trains_and_leaves_weights_and_refuses_to_overwrite_them(dataset, tmp_path):
    training = replace(TRAINING, schedule=replace(SCHEDULE, epochs=1))
    path = train_ssle_phase(dataset, tmp_path, config=NETWORK, training=training, limit=4, progress=False)
    assert path.is_file()
    assert path.name == "ssle-phase.safetensors"
    with pytest.raises(OutputError, match="resume"):
        train_ssle_phase(dataset, tmp_path, config=NETWORK, training=training, limit=4, progress=False)


def test_data_set_of_another_size_is_refused(dataset, tmp_path):
    with pytest.raises(InvalidValueError, match=r"\(256, 256\)"):
        train_ssle_phase(dataset, tmp_path, config=SslePhaseConfig(), training=TRAINING, progress=False)


@pytest.mark.parametrize("change", [{"l1_weight": -1.0}, {"coarse_weight": -1.0}, {"gain_range": 1.0}, {"max_scale_mm": 0.0}])
def test_impossible_setting_is_refused(change):
    with pytest.raises(InvalidValueError):
        replace(TRAINING, **change)


def _errors_mm(recipe, batch):
    # In training mode: after so few steps the running statistics are not those of the frames yet.
    with torch.no_grad():
        return (recipe.predict(batch).depth_mm - batch["depth_mm"]).abs()
