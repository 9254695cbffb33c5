from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.vq_vae import VqVae
from laploop.perception.training.run import TrainingRun, train_network
from laploop.perception.training.samples import Samples, loader
from laploop.perception.training.settings import DualUNetTraining, Machine, Schedule, SsleLoss, SsleTraining
from laploop.perception.training.ssle import UNetRecipe
from laploop.perception.training.stage_module import EpochWriter

OPTICS = ScopeOptics(width=64, height=64, mask=StripeMask(stripes=8))
RIG = Rig.from_optics(OPTICS)
SSLE, DUAL = (NETWORKS.get(name).sized("tiny").for_image(64, 64) for name in ("ssle", "dual-unet"))
TINY = NETWORKS.get("ssle").trainings["tiny"]
CPU = Machine(accelerator="cpu", tensorboard=False)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory, render):
    """Eight rolling surfaces whose edge has no truth, each in both splits."""
    path = tmp_path_factory.mktemp("data") / "frames"
    split = np.array([0] * 8 + [1] * 8, np.uint8)
    store = FrameStore.create(
        path, optics=OPTICS, tissue_seed=np.arange(16), split=split, tool_in_view=np.zeros(16, bool), config={}
    )
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(-1, 1, 64))
    for index in range(8):
        depth_m = 0.08 + 0.004 * index + 0.004 * np.sin(3 * x + index) * np.cos(2 * y)
        image = render(RIG, depth_m)
        depth_mm = (1e3 * depth_m).astype(np.float32)
        depth_mm[:6] = np.nan
        for row in (index, index + 8):
            store.write(row, image=image, depth_mm=depth_mm, lit=np.ones((64, 64), bool))
    return open_dataset(path)


def _last_mae_mm(out):
    lines = (out / "log.csv").read_text().splitlines()
    return float(dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))["val_mae_mm"])


def _train(name, dataset, out, config, training, **options):
    run = TrainingRun(dataset=dataset, out=out, machine=CPU, progress=False, **options)
    return train_network(NETWORKS.get(name), run, {"config": config, "training": training})


def _ssle(dataset, out, **options):
    return _train("ssle", dataset, out, SSLE, TINY, **options)


def test_short_training_overfits_eight_frames_to_under_a_millimetre(dataset, tmp_path):
    schedule = Schedule(epochs=70, batch=8, learning_rate=2e-2, final_learning_rate=1e-5, per_step=True)
    config = replace(DUAL, depth=replace(DUAL.depth, base=16))
    training = DualUNetTraining(schedule=schedule)
    _train("dual-unet", dataset, tmp_path / "out", config, training)
    assert _last_mae_mm(tmp_path / "out") < 1.0  # mm, the frames that were learned


@pytest.mark.slow
def test_all_stages_of_ssle_overfit_eight_frames_to_under_a_millimetre(dataset, tmp_path):
    vq = Schedule(epochs=100, batch=4, learning_rate=3e-3, final_learning_rate=1e-5, per_step=True)
    unet = Schedule(epochs=300, batch=4, learning_rate=3e-3, final_learning_rate=1e-5, per_step=True, clip_norm=5.0)
    training = SsleTraining(vq=vq, unet=unet, tune_decoder=True)
    _train("ssle", dataset, tmp_path / "out", SSLE, training)
    assert _last_mae_mm(tmp_path / "out") < 1.0  # mm, the frames that were learned


def test_stages_leave_their_weights_and_resume_to_the_same_bits(dataset, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    path = _ssle(dataset, whole)
    _ssle(dataset, parts)
    # As after a stop before the last stage's first epoch was over, and in the first stage.
    for name in ("checkpoint.safetensors", "log.csv", "ssle.safetensors", "vq-depth/checkpoint.safetensors"):
        (parts / name).unlink()
    with pytest.raises(OutputError, match="resume"):
        _ssle(dataset, parts)
    again = load_file(_ssle(dataset, parts, resume=True))
    assert all(value.equal(again[name]) for name, value in load_file(path).items())
    assert (whole / "vq-image" / "vq-image.safetensors").is_file()


def _kept(dataset, out, epochs=3, **changes):
    """Train with two variants of each frame, whose codes are kept in memory."""
    training = replace(TINY, variants=2, gain_range=0.15, unet=replace(TINY.unet, epochs=epochs))
    return _train("ssle", dataset, out, SSLE, training, **changes)


def test_resuming_with_kept_codes_ends_in_the_same_bits(dataset, tmp_path, monkeypatch):
    whole = load_file(_kept(dataset, tmp_path / "whole"))
    derive, calls = UNetRecipe.derive, []

    def count(recipe, sample):
        calls.append(sample)
        return derive(recipe, sample)

    monkeypatch.setattr(UNetRecipe, "derive", count)
    write = EpochWriter.on_train_epoch_end

    def stop(writer, trainer, module):
        write(writer, trainer, module)
        if module.recipe.name == "ssle" and trainer.current_epoch == 1:
            raise RuntimeError("stopped")

    with monkeypatch.context() as patch:
        patch.setattr(EpochWriter, "on_train_epoch_end", stop)
        with pytest.raises(RuntimeError, match="stopped"):
            _kept(dataset, tmp_path / "parts")
    assert len(calls) == 8 * 2 + 8  # two variants of the training frames, one of the validation frames, each once
    again = load_file(_kept(dataset, tmp_path / "parts", resume=True))
    assert all(value.equal(again[name]) for name, value in whole.items())


def test_kept_codes_give_the_loss_of_the_frozen_layers(dataset):
    training = replace(TINY, variants=1)
    parts = VqVae(SSLE.image), VqVae(SSLE.depth)
    recipe = UNetRecipe(SSLE, training, *parts, (torch.zeros(8), torch.ones(8)))
    samples = Samples.read(dataset, "val", recipe)
    batch = next(iter(loader(samples, recipe, training=False)))
    assert batch["codes"].shape == batch["target_codes"].shape == (2, 32, 32)
    plain = {name: value for name, value in batch.items() if "codes" not in name}
    kept, anew = recipe.loss(batch, 0.5), recipe.loss(plain, 0.5)
    torch.testing.assert_close(kept.total, anew.total, rtol=1e-4, atol=0.0)
    for name, value in anew.parts.items():
        torch.testing.assert_close(kept.parts[name], value, rtol=1e-4, atol=0.0)


def test_only_the_unet_learns_in_the_last_stage_unless_the_decoder_is_freed(dataset, tmp_path):
    trained = load_file(_ssle(dataset, tmp_path / "out"))
    image = load_file(tmp_path / "out" / "vq-image" / "vq-image.safetensors")
    depth = load_file(tmp_path / "out" / "vq-depth" / "vq-depth.safetensors")
    for mine, theirs, source in (
        ("encoder", "encoder", image),
        ("decoder", "decoder", depth),
        ("quantizer", "quantizer", image),
    ):
        names = [name for name in source if name.startswith(theirs)]
        assert names
        assert all(trained[name.replace(theirs, mine, 1)].equal(source[name]) for name in names)
    assert not np.allclose(trained["latent_deviation"].numpy(), 1.0)


def test_data_set_that_does_not_fit_is_refused(dataset, tmp_path):
    tiny = NETWORKS.get("ssle").sized("tiny")
    for config, against, message in ((tiny, "exact", "height, width"), (SSLE, "zivid", "reference camera")):
        with pytest.raises(InvalidValueError, match=message):
            _train("ssle", dataset, tmp_path / "out", config, TINY, against=against)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("change", [{"variants": -1}, {"gain_range": -0.1}])
def test_impossible_augmentation_is_refused(change):
    with pytest.raises(InvalidValueError):
        SsleTraining(**change)


@pytest.mark.parametrize("change", [{"alpha": 1.5}, {"beta_end": -1.0}, {"commitment": float("nan")}])
def test_impossible_loss_weights_are_refused(change):
    with pytest.raises(InvalidValueError):
        SsleLoss(**change)
