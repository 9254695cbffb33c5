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
from laploop.perception.networks.configs import CompactConfig, SslePhaseConfig
from laploop.perception.networks.phase_front import rig_numbers
from laploop.perception.training.compact import CompactRecipe
from laploop.perception.training.options import SslePhaseOptions
from laploop.perception.training.run import TrainingRun, train_network
from laploop.perception.training.samples import Samples, stack
from laploop.perception.training.settings import Machine, PhaseTraining, Schedule, SslePhaseTraining
from laploop.perception.training.ssle_phase import SslePhaseRecipe
from laploop.perception.weights import load_weights

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
WIDER = replace(
    OPTICS, baseline_m=0.0055, fov_rad=math.radians(66.0), mask=StripeMask(stripes=12, phase=0.4, fov_rad=math.radians(66.0))
)
NETWORK = SslePhaseConfig(reader=CompactConfig(height=128, width=128, widths=(16, 32)), refiner_widths=(16, 32))
SCHEDULE = Schedule(
    epochs=24, batch=2, learning_rate=4e-3, final_learning_rate=1e-5, per_step=True, warmup_steps=4, optimizer="muon"
)
STAGE = PhaseTraining(schedule=SCHEDULE, gain_range=0.0, painted_share=0.0)
TRAINING = SslePhaseTraining(reader=STAGE, refiner=STAGE)


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


def test_sample_brings_the_rig_of_its_frame(dataset):
    recipe = CompactRecipe(NETWORK.reader, STAGE)
    samples = Samples.read(dataset, "train", recipe)
    batch = stack([recipe.augment(samples.rows[row], np.random.default_rng(row)) for row in range(2)])
    assert batch["rig"].dtype == torch.float64
    for row, optics in enumerate((OPTICS, WIDER)):
        assert tuple(batch["rig"][row].tolist()) == rig_numbers(Rig.from_optics(optics))


def test_short_training_overfits_eight_frames_of_two_rigs_to_under_a_millimetre(dataset):
    first = CompactRecipe(NETWORK.reader, STAGE)
    batch = stack(Samples.read(dataset, "train", first).rows)
    _overfit(first, batch, steps=96)
    read = float(_errors_mm(first, batch).mean())
    second = SslePhaseRecipe(NETWORK, TRAINING)
    second.phase.compact.load_state_dict(first.network.state_dict())
    _overfit(second, batch, steps=128)
    after = float(_errors_mm(second, batch).mean())
    # mm, over all pixels, those beyond the lit field included.
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
    once = replace(STAGE, schedule=replace(SCHEDULE, epochs=1))
    training = SslePhaseTraining(reader=once, refiner=once)
    path = _train(dataset, tmp_path, training=training)
    assert path == tmp_path / "ssle-phase.safetensors"
    with pytest.raises(OutputError, match="resume"):
        _train(dataset, tmp_path, training=training)
    # A trained reader can be handed over; the whole network holds it unchanged.
    reader = tmp_path / "reader" / "compact.safetensors"
    other = _train(dataset, tmp_path / "other", training=training, reader=reader)
    assert not (tmp_path / "other" / "reader").exists()
    given, _ = load_weights(reader, NETWORK.reader.architecture)
    whole, _ = load_weights(other, NETWORK.architecture)
    assert all(torch.equal(whole[f"compact.{name}"], tensor) for name, tensor in given.items())


def test_training_goes_on_from_a_whole_network(dataset, tmp_path):
    once = replace(STAGE, schedule=replace(SCHEDULE, epochs=1, warmup_steps=0))
    training = SslePhaseTraining(reader=once, refiner=once)
    path = _train(dataset, tmp_path / "first", training=training, limit=2)
    slow = replace(once.schedule, learning_rate=1e-9, final_learning_rate=1e-9)
    still = replace(training, refiner=replace(once, schedule=slow))
    again = _train(dataset, tmp_path / "again", training=still, start=path, limit=2)
    assert not (tmp_path / "again" / "reader").exists()
    fresh = SslePhaseRecipe(NETWORK, training).network.state_dict()
    before, after = (load_weights(one, NETWORK.architecture, fresh)[0] for one in (path, again))
    assert all(torch.equal(after[name], tensor) for name, tensor in before.items() if name.startswith("compact."))
    # All but untouched by a rate of next to nothing.
    kernel = "refiner.trunk.stem.0.0.weight"
    torch.testing.assert_close(after[kernel], before[kernel], rtol=0.0, atol=1e-6)
    assert float((fresh[kernel] - before[kernel]).abs().max()) > 1e-3
    with pytest.raises(WeightsError, match="first weights is 'file"):
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


def _errors_mm(recipe, batch):
    # In training mode: after so few steps the running statistics are not those of the frames yet.
    with torch.no_grad():
        return (recipe.predict(batch).depth_mm - batch["depth_mm"]).abs()
