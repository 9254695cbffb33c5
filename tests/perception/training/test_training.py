import math

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, OutputError, WeightsError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.networks.compact_unet import CompactConfig, CompactOutput
from laploop.perception.training import (
    CHECKPOINT_NAME,
    LOG_NAME,
    CompactTrainer,
    CompactTraining,
    Frames,
    laplace_loss,
    train_compact,
)
from laploop.perception.weights import load_weights

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
NETWORK = CompactConfig(widths=(16, 24, 32))


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
    return path


def _settings(**changes):
    return CompactTraining(**{"epochs": 3, "batch": 4, "warmup_steps": 2, "bfloat16": False, **changes})


def test_loss_is_the_laplace_likelihood_plus_the_weighted_error():
    depth = torch.tensor([[[100.0, 90.0]]])
    log_scale = torch.tensor([[[0.0, 1.0]]])
    truth = torch.tensor([[[103.0, 85.0]]])
    loss, error = laplace_loss(CompactOutput(turns=depth, depth_mm=depth, log_scale=log_scale), truth, 0.5)
    assert float(error) == pytest.approx(4.0)
    by_hand = 0.5 * ((3.0 / 1.0 + 0.0 + 1.5) + (5.0 / math.e + 1.0 + 2.5))
    assert float(loss) == pytest.approx(by_hand, rel=1e-6)


def test_pixels_without_truth_have_no_influence():
    depth = torch.full((1, 2, 2), 100.0, requires_grad=True)
    truth = torch.tensor([[[101.0, float("nan")], [5.0, 900.0]]])
    loss, error = laplace_loss(CompactOutput(turns=depth, depth_mm=depth, log_scale=torch.zeros(1, 2, 2)), truth, 0.0)
    loss.backward()
    assert float(error.detach()) == pytest.approx(1.0)
    assert torch.count_nonzero(depth.grad) == 1


def test_rate_starts_low_peaks_at_its_setting_and_ends_at_a_hundredth(small_rig):
    trainer = CompactTrainer(small_rig, NETWORK, _settings(learning_rate=1e-3, warmup_steps=9))
    assert trainer.learning_rate(0, 1000) == pytest.approx(1e-4, rel=0.01)
    assert trainer.learning_rate(9, 1000) == pytest.approx(1e-3, rel=0.01)
    assert trainer.learning_rate(1000, 1000) == pytest.approx(1e-5, rel=0.01)


def test_short_training_overfits_eight_frames_to_under_a_millimetre(dataset, small_rig):
    settings = _settings(epochs=24, batch=2, learning_rate=4e-3, gain_range=0.0)
    trainer = CompactTrainer(small_rig, CompactConfig(widths=(16, 32)), settings)
    train = Frames.read(FrameStore.open(dataset), "train")
    first = trainer.run_epoch(train, train)
    for _ in range(23):
        last = trainer.run_epoch(train, train)
    assert last.val_mae_mm < 1.0  # mm, over all pixels, those beyond the lit field included
    assert last.val_mae_mm < 0.3 * first.val_mae_mm


def test_interrupted_training_goes_on_to_the_same_bits(dataset, tmp_path, small_rig):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    path = train_compact(dataset, whole, training=_settings(), network=NETWORK, progress=False)

    class Interruption(Exception):  # noqa: N818 - stands for Ctrl-C
        pass

    original = CompactTrainer.run_epoch

    def interrupted(self, train, val):
        if self.epoch == 1:
            raise Interruption
        return original(self, train, val)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CompactTrainer, "run_epoch", interrupted)
        with pytest.raises(Interruption):
            train_compact(dataset, parts, training=_settings(), network=NETWORK, progress=False)
    resumed = train_compact(dataset, parts, training=_settings(), network=NETWORK, resume=True, progress=False)
    trainer = CompactTrainer(small_rig, NETWORK, _settings())
    one, _ = load_weights(path, NETWORK.architecture, trainer.network.state_dict())
    two, _ = load_weights(resumed, NETWORK.architecture, trainer.network.state_dict())
    assert all(torch.equal(one[name], two[name]) for name in one)
    assert len((parts / LOG_NAME).read_text().splitlines()) == 4


def test_checkpoint_is_not_overwritten_by_a_fresh_start(dataset, tmp_path):
    train_compact(dataset, tmp_path / "out", training=_settings(epochs=1), network=NETWORK, progress=False)
    with pytest.raises(OutputError, match="resume"):
        train_compact(dataset, tmp_path / "out", training=_settings(epochs=2), network=NETWORK, progress=False)


def test_checkpoint_of_another_network_is_refused(dataset, tmp_path):
    train_compact(dataset, tmp_path / "out", training=_settings(epochs=1), network=NETWORK, progress=False)
    other = CompactConfig(widths=(16, 24, 40))
    with pytest.raises(WeightsError, match="architecture"):
        train_compact(dataset, tmp_path / "out", training=_settings(), network=other, resume=True, progress=False)


def test_truncated_checkpoint_is_refused(dataset, tmp_path):
    out = tmp_path / "out"
    train_compact(dataset, out, training=_settings(epochs=1), network=NETWORK, progress=False)
    content = (out / CHECKPOINT_NAME).read_bytes()
    (out / CHECKPOINT_NAME).write_bytes(content[: len(content) // 2])
    with pytest.raises(WeightsError, match="truncated"):
        train_compact(dataset, out, training=_settings(), network=NETWORK, resume=True, progress=False)


@pytest.mark.parametrize("change", [{"epochs": 0}, {"batch": 0}, {"learning_rate": -1.0}, {"gain_range": 1.0}])
def test_impossible_schedule_is_refused(change):
    with pytest.raises(InvalidValueError):
        _settings(**change)
