import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, OutputError, WeightsError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.configs import SslePhaseConfig
from laploop.perception.networks.depth_network import PhaseOutput
from laploop.perception.networks.ssle_phase_front import rig_numbers
from laploop.perception.networks.ssle_phase_reader import PhaseReading
from laploop.perception.training.options import SslePhaseOptions
from laploop.perception.training.run import TrainingRun, train_network
from laploop.perception.training.samples import SampleDataset, Samples, stack
from laploop.perception.training.settings import Machine, Schedule, SslePhaseTraining
from laploop.perception.training.ssle_phase import ReaderRecipe, SslePhaseRecipe, reader_loss, ssle_phase_loss
from laploop.perception.weights import load_weights

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
WIDER = replace(
    OPTICS, baseline_m=0.0055, fov_rad=math.radians(66.0), mask=StripeMask(stripes=12, phase=0.4, fov_rad=math.radians(66.0))
)
NETWORK = SslePhaseConfig(height=128, width=128, reader_widths=(16, 32), reader_fine_width=16, refiner_widths=(16, 32))
SCHEDULE = Schedule(
    epochs=24, batch=2, learning_rate=4e-3, final_learning_rate=1e-5, per_step=True, warmup_steps=4, optimizer="muon"
)
TRAINING = SslePhaseTraining(reader=SCHEDULE, refiner=SCHEDULE, gain_range=0.0)


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


def _train(dataset, out, *, resume=False, limit=4, config=NETWORK, **settings):
    machine = Machine(accelerator="cpu", tensorboard=False)
    run = TrainingRun(dataset=dataset, out=out, machine=machine, limit=limit, resume=resume, progress=False)
    return train_network(NETWORKS.get("ssle-phase"), run, {"config": config, **settings})


def _output(depth, log_scale):
    return PhaseOutput(turns=depth, depth_mm=depth, log_scale=log_scale)


def test_loss_is_likelihood_and_absolute_error():
    depth, log_scale = torch.tensor([[[100.0, 90.0]]]), torch.tensor([[[0.0, 1.0]]])
    truth = torch.tensor([[[103.0, 85.0]]])
    loss = ssle_phase_loss(_output(depth, log_scale), truth, replace(TRAINING, l1_weight=0.5))
    by_hand = 0.5 * ((3.0 + 0.0 + 0.5 * 3.0) + (5.0 / math.e + 1.0 + 0.5 * 5.0))
    assert float(loss.total) == pytest.approx(by_hand, rel=1e-6)
    assert float(loss.parts["mae_mm"]) == pytest.approx(4.0)


def test_readers_loss_adds_what_came_before_the_second_demodulation():
    metre = torch.tensor([[[0.1]]])

    def turns(*depths_mm):
        return 1e3 * metre / torch.tensor([[depths_mm]])

    # Scales in turns that are 1 mm and e mm.
    scale = torch.log(metre / (1e-3 * torch.tensor([[[100.0, 90.0]]]).square())) + torch.tensor([[[0.0, 1.0]]])
    reading = PhaseReading(
        turns=turns(100.0, 90.0),
        first_turns=turns(104.0, 85.0),
        coarse_turns=turns(103.0, 85.0 * math.e),
        log_scale=scale,
    )
    training = replace(TRAINING, l1_weight=0.5, coarse_weight=2.0)
    loss = reader_loss(reading, metre, torch.tensor([[[103.0, 85.0]]]), training)
    by_hand = 0.5 * ((3.0 + 0.0 + 0.5 * (3.0 + 1.0)) + (5.0 / math.e + 1.0 + 0.5 * (5.0 + 0.0) + 2.0 * 1.0))
    assert float(loss.total) == pytest.approx(by_hand, rel=1e-4)


def test_pixels_without_truth_have_no_influence():
    depth = torch.full((1, 2, 2), 100.0, requires_grad=True)
    truth = torch.tensor([[[101.0, float("nan")], [float("nan"), float("nan")]]])
    ssle_phase_loss(_output(depth, torch.zeros(1, 2, 2)), truth, TRAINING).total.backward()
    assert torch.isfinite(depth.grad).all()
    assert torch.count_nonzero(depth.grad) == 1


def test_what_is_too_near_to_be_told_is_learned_to_be_unknown():
    depth, log_scale = torch.full((1, 1, 2), 100.0), torch.zeros(1, 1, 2, requires_grad=True)
    loss = ssle_phase_loss(_output(depth, log_scale), torch.tensor([[[101.0, 5.0]]]), replace(TRAINING, l1_weight=0.5))
    assert float(loss.total.detach()) == pytest.approx(0.5 * (1.0 + 95.0) + 0.5 * 1.0)
    assert float(loss.parts["mae_mm"]) == pytest.approx(1.0)
    loss.total.backward()
    # The slope of |error| exp(-s) + s at s = 0, half of it for each of the two.
    torch.testing.assert_close(log_scale.grad, torch.tensor([[[0.0, -47.0]]]))


def test_sample_brings_the_rig_of_its_frame(dataset):
    recipe = ReaderRecipe(NETWORK, TRAINING)
    samples = Samples.read(dataset, "train", recipe)
    batch = stack([recipe.augment(samples.rows[row], np.random.default_rng(row)) for row in range(2)])
    assert batch["rig"].dtype == torch.float64
    for row, optics in enumerate((OPTICS, WIDER)):
        assert tuple(batch["rig"][row].tolist()) == rig_numbers(Rig.from_optics(optics))


def test_kept_reading_is_what_the_reader_says(dataset):
    recipe = SslePhaseRecipe(ReaderRecipe(NETWORK, TRAINING).phase, TRAINING)
    samples = Samples.read(dataset, "train", recipe)
    kept = SampleDataset(samples, recipe, training=False)
    with torch.no_grad():
        fresh = recipe.predict(stack(samples.rows[:2])).depth_mm
        again = recipe.predict(stack([kept[0, row] for row in range(2)])).depth_mm
    # The scale is kept in half precision, and one frame at a time is summed in another order than two.
    torch.testing.assert_close(again, fresh, rtol=0.0, atol=0.05)


def test_short_training_overfits_eight_frames_of_two_rigs_to_under_a_millimetre(dataset):
    first = ReaderRecipe(NETWORK, TRAINING)
    batch = stack(Samples.read(dataset, "train", first).rows)
    before = float(_errors_mm(first, batch).mean())
    _overfit(first, batch, steps=64)
    read = float(_errors_mm(first, batch).mean())
    second = SslePhaseRecipe(first.phase, TRAINING)
    _overfit(second, batch, steps=48)
    after = float(_errors_mm(second, batch).mean())
    # mm, over all pixels, those beyond the lit field included.
    assert read < 0.3 * before
    assert after < 1.0
    assert after < read


def _overfit(recipe, batch, steps):
    optimizer = torch.optim.Adam(recipe.parameters())
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = SCHEDULE.rate(step, steps // SCHEDULE.epochs + 1)
        rows = slice(2 * (step % 4), 2 * (step % 4) + 2)
        optimizer.zero_grad()
        recipe.loss({name: value[rows] for name, value in batch.items()}, step / steps).total.backward()
        optimizer.step()


def test_command_trains_both_stages_and_refuses_to_overwrite_them(dataset, tmp_path):
    training = replace(TRAINING, reader=replace(SCHEDULE, epochs=1), refiner=replace(SCHEDULE, epochs=1))
    path = _train(dataset, tmp_path, training=training)
    assert path == tmp_path / "ssle-phase.safetensors"
    with pytest.raises(OutputError, match="resume"):
        _train(dataset, tmp_path, training=training)
    # A trained reader can be handed over; the whole network holds it unchanged.
    reader = tmp_path / "reader" / "reader.safetensors"
    other = _train(dataset, tmp_path / "other", training=training, reader=reader)
    assert not (tmp_path / "other" / "reader").exists()
    recipe = ReaderRecipe(NETWORK, training)
    given, _ = load_weights(reader, recipe.architecture, recipe.network.state_dict())
    whole, _ = load_weights(other, NETWORK.architecture, recipe.phase.state_dict())
    assert all(torch.equal(whole[f"reader.{name}"], tensor) for name, tensor in given.items())


def test_training_goes_on_from_a_whole_network(dataset, tmp_path):
    training = replace(TRAINING, reader=replace(SCHEDULE, epochs=1), refiner=replace(SCHEDULE, epochs=1, warmup_steps=0))
    path = _train(dataset, tmp_path / "first", training=training, limit=2)
    still = replace(training, refiner=replace(training.refiner, learning_rate=1e-9, final_learning_rate=1e-9))
    again = _train(dataset, tmp_path / "again", training=still, start=path, limit=2)
    assert not (tmp_path / "again" / "reader").exists()
    fresh = ReaderRecipe(NETWORK, training).phase.state_dict()
    before, after = (load_weights(one, NETWORK.architecture, fresh)[0] for one in (path, again))
    assert all(torch.equal(after[name], tensor) for name, tensor in before.items() if name.startswith("reader."))
    # All but untouched by a rate of next to nothing.
    kernel = "refiner.trunk.stem.0.0.weight"
    torch.testing.assert_close(after[kernel], before[kernel], rtol=0.0, atol=1e-6)
    assert float((fresh[kernel] - before[kernel]).abs().max()) > 1e-3
    with pytest.raises(WeightsError, match="first stage is 'start"):
        _train(dataset, tmp_path / "again", training=still, start=again, limit=2, resume=True)


@pytest.mark.parametrize(
    "given",
    [
        {"reader": "a", "reader_epochs": 3},
        {"start": "a", "reader_epochs": 3},
        {"start": "a", "reader": "b"},
    ],
)
def test_first_stage_comes_from_one_place(given):
    paths = {name: value if name == "reader_epochs" else Path(value) for name, value in given.items()}
    with pytest.raises(InvalidValueError, match="the first stage is trained, read from a file, or part of a whole network"):
        SslePhaseOptions(**paths)


def test_data_set_of_another_size_is_refused(dataset, tmp_path):
    with pytest.raises(InvalidValueError, match=r"\(256, 256\)"):
        _train(dataset, tmp_path, config=SslePhaseConfig(), training=TRAINING)


@pytest.mark.parametrize(
    "change",
    [
        {"l1_weight": -1.0},
        {"coarse_weight": -1.0},
        {"gain_range": 1.0},
        {"variants": 0},
        {"norm_momentum": 0.0},
        {"max_scale_mm": 0.0},
    ],
)
def test_impossible_setting_is_refused(change):
    with pytest.raises(InvalidValueError):
        replace(TRAINING, **change)


def _errors_mm(recipe, batch):
    # In training mode: after so few steps the running statistics are not those of the frames yet.
    with torch.no_grad():
        return (recipe.predict(batch).depth_mm - batch["depth_mm"]).abs()
