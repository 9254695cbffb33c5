from dataclasses import replace

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import MissingFileError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.estimators import make_estimator
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.training.compact import CompactRecipe
from laploop.perception.training.run import TrainingRun, train_network
from laploop.perception.training.samples import Samples, stack
from laploop.perception.training.settings import Machine, PhaseTraining, Schedule
from laploop.perception.weights import load_weights

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
NETWORK = CompactConfig(width=128, height=128, widths=(16, 32))


@pytest.fixture
def dataset(tmp_path, small_rig, render):
    """Eight frames of gently rolling surfaces, and two to validate on."""
    path = tmp_path / "frames"
    rng = np.random.default_rng(0)
    split = np.array([0] * 8 + [1] * 2, np.uint8)
    store = FrameStore.create(
        path, optics=OPTICS, tissue_seed=np.arange(10), split=split, tool_in_view=np.zeros(10, bool), config={}
    )
    x, y = np.meshgrid(np.linspace(-1, 1, 128), np.linspace(-1, 1, 128))
    for index in range(10):
        a, b, c = rng.uniform(0.0, 2.0 * np.pi, 3)
        depth_m = rng.uniform(0.08, 0.11) + 0.005 * np.sin(3 * x + a) * np.cos(2 * y + b) + 0.003 * np.sin(4 * y + c)
        image = render(small_rig, depth_m, rng=rng)
        store.write(index, image=image, depth_mm=(1e3 * depth_m).astype(np.float32), lit=np.ones((128, 128), bool))
    return FrameStore.open(path)


def _settings(**changes):
    schedule = Schedule(**{"epochs": 3, "batch": 4, "warmup_steps": 2, "per_step": True, "optimizer": "muon", **changes})
    return PhaseTraining(schedule=schedule, gain_range=0.0, painted_share=0.0)


def test_short_training_overfits_eight_frames_to_under_a_millimetre(dataset):
    settings = _settings(epochs=24, batch=2, learning_rate=4e-3, final_learning_rate=4e-5)
    recipe = CompactRecipe(NETWORK, settings)
    batch = stack(Samples.read(dataset, "train", recipe).rows)
    optimizer = torch.optim.AdamW(recipe.parameters(), weight_decay=1e-4)

    def error_mm():
        # In training mode: after so few steps the running statistics are not those of the frames yet.
        with torch.no_grad():
            return float((recipe.predict(batch).depth_mm - batch["depth_mm"]).abs().mean())

    before = error_mm()
    for step in range(96):
        optimizer.param_groups[0]["lr"] = recipe.schedule.rate(step, 4)
        rows = slice(2 * (step % 4), 2 * (step % 4) + 2)
        optimizer.zero_grad()
        recipe.loss({name: value[rows] for name, value in batch.items()}, step / 96).total.backward()
        optimizer.step()
    assert error_mm() < 1.0  # mm, over all pixels, those beyond the lit field included
    assert error_mm() < 0.3 * before


def test_trained_network_of_any_widths_is_an_estimator(dataset, small_rig, tmp_path):
    run = TrainingRun(dataset=dataset, out=tmp_path, machine=Machine(accelerator="cpu", tensorboard=False), progress=False)
    settings = {"config": replace(NETWORK, widths=(8, 16)), "training": _settings(epochs=1)}
    path = train_network(NETWORKS.get("compact"), run, settings)
    assert path == tmp_path / "compact.safetensors"
    assert {file.name for file in tmp_path.iterdir()} >= {"compact.safetensors", "log.csv", "checkpoint.safetensors"}
    estimate = make_estimator("compact", small_rig, path).estimate(dataset.image(0))
    assert np.isfinite(estimate.depth_mm).all()


def test_training_goes_on_from_trained_weights(dataset, tmp_path):
    def trained(out, **settings):
        run = TrainingRun(
            dataset=dataset, out=out, machine=Machine(accelerator="cpu", tensorboard=False), limit=2, progress=False
        )
        return train_network(NETWORKS.get("compact"), run, {"config": NETWORK, **settings})

    first = trained(tmp_path / "first", training=_settings(epochs=1))
    still = _settings(epochs=1, learning_rate=1e-9, final_learning_rate=1e-9)
    again = trained(tmp_path / "again", training=still, start=first)
    before, after = (load_weights(path, NETWORK.architecture)[0] for path in (first, again))
    kernel = "reader.trunk.stem.0.0.weight"
    torch.testing.assert_close(after[kernel], before[kernel], rtol=0.0, atol=1e-6)
    with pytest.raises(MissingFileError, match="nowhere"):
        trained(tmp_path / "other", training=still, start=tmp_path / "nowhere.safetensors")
