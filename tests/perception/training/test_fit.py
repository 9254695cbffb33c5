import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, MissingFileError, OutputError, WeightsError
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.training import fit as fit_module
from laploop.perception.training.fit import fit
from laploop.perception.training.recipe import Loss, Prediction, Recipe, flip_and_gain, seeded
from laploop.perception.training.samples import EpochSampler, Samples
from laploop.perception.training.settings import Machine, Schedule

CPU = Machine(accelerator="cpu", tensorboard=False)
OPTICS = ScopeOptics(width=32, height=32, mask=StripeMask(stripes=4))


class Line(Recipe):
    """Depth from grey value by two small convolutions, which four frames can teach."""

    name = "line"

    def __init__(self, **changes):
        self.schedule = Schedule(**{"epochs": 3, "batch": 2, "learning_rate": 1e-2, "accumulate": 2, **changes})
        layers = lambda: torch.nn.Sequential(  # noqa: E731 - made under a seed
            torch.nn.Conv2d(1, 4, 3, padding=1), torch.nn.BatchNorm2d(4), torch.nn.Dropout(0.2), torch.nn.Conv2d(4, 1, 1)
        )
        self.network = seeded(layers, self.schedule.seed)

    @property
    def architecture(self):
        return {"format": "line"}

    def augment(self, sample, rng):
        return flip_and_gain(sample, rng, 0.1)

    def loss(self, batch, progress):
        error = self.predict(batch).depth_mm - torch.nan_to_num(batch["depth_mm"], nan=100.0)
        return Loss(total=error.abs().mean(), parts={"progress": torch.tensor(progress)})

    def predict(self, batch):
        depth = 100.0 + self.network(batch["image"][:, None] / 255.0)[:, 0]
        return Prediction(depth_mm=depth, valid=batch["image"] > 100.0)


@pytest.fixture
def dataset(tmp_path):
    return _dataset(tmp_path / "frames")


def _dataset(path, frames=6):
    rng = np.random.default_rng(0)
    split = np.array([0] * (frames - 2) + [1] * 2, np.uint8)
    store = FrameStore.create(
        path, optics=OPTICS, tissue_seed=np.arange(frames), split=split, tool_in_view=np.zeros(frames, bool), config={}
    )
    for index in range(frames):
        image = rng.integers(0, 256, (32, 32)).astype(np.uint8)
        depth_mm = (90.0 + image / 25.5).astype(np.float32)
        depth_mm[:3] = np.nan
        store.write(index, image=image, depth_mm=depth_mm, lit=np.ones((32, 32), bool))
    return open_dataset(path)


def _samples(dataset, recipe):
    return Samples.read(dataset, "train", recipe), Samples.read(dataset, "val", recipe)


def _bytes(folder):
    """Return the weights as bytes; the file itself has its notes in an order of chance."""
    tensors = load_file(folder / "line.safetensors")
    return {name: tensor.numpy().tobytes() for name, tensor in tensors.items()}


def test_cosine_once_an_epoch_reaches_its_end_in_the_last_epoch_as_the_paper_has_it():
    paper = Schedule(epochs=161, learning_rate=1e-3, final_learning_rate=1e-6)
    assert paper.rate(0, 10) == paper.rate(9, 10) == 1e-3
    assert paper.rate(80 * 10, 10) == pytest.approx((1e-3 + 1e-6) / 2.0)
    assert paper.rate(160 * 10, 10) == pytest.approx(1e-6)
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimizer = torch.optim.Adam([parameter], lr=1e-3)
    reference = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=160, eta_min=1e-6)
    for epoch in range(161):
        assert paper.rate(epoch * 10, 10) == pytest.approx(reference.get_last_lr()[0], rel=1e-9)
        optimizer.step()
        reference.step()


def test_rate_can_fall_at_every_step_after_a_linear_start():
    schedule = Schedule(epochs=2, learning_rate=1.0, final_learning_rate=0.0, per_step=True, warmup_steps=3)
    assert schedule.rate(0, 100) == pytest.approx(0.25)
    assert schedule.rate(100, 100) == pytest.approx(0.5)
    assert schedule.rate(199, 100) < 1e-3


@pytest.mark.parametrize(
    "change", [{"epochs": 0}, {"batch": 0}, {"accumulate": 0}, {"learning_rate": 1e-7}, {"clip_norm": -1.0}]
)
def test_impossible_schedule_is_refused(change):
    with pytest.raises(InvalidValueError):
        Schedule(**{"epochs": 1, **change})


def test_order_depends_on_seed_and_epoch_alone_and_processes_share_it():
    whole = EpochSampler(7, seed=3, shuffle=True)
    whole.set_epoch(5)
    keys = list(whole)
    assert sorted(row for _, row in keys) == list(range(7))
    assert list(whole) == keys
    parts = [EpochSampler(7, seed=3, shuffle=True, rank=rank, processes=2) for rank in range(2)]
    for part in parts:
        part.set_epoch(5)
    assert [len(list(part)) for part in parts] == [4, 4]
    assert {row for part in parts for _, row in part} == set(range(7))
    whole.set_epoch(6)
    assert [row for _, row in whole] != [row for _, row in keys]


def test_flip_turns_every_map_and_no_vector():
    rng = np.random.default_rng(0)
    image = np.arange(6, dtype=np.uint8).reshape(3, 2)
    sample = {"image": image, "depth_mm": image.astype(np.float32), "rig": np.arange(3.0)}
    flips = 0
    for _ in range(20):
        changed = flip_and_gain(sample, rng, 0.0)
        flipped = not np.array_equal(changed["image"], image)
        flips += flipped
        np.testing.assert_array_equal(changed["depth_mm"], image[::-1] if flipped else image)
        np.testing.assert_array_equal(changed["rig"], np.arange(3.0))
    assert 0 < flips < 20


def test_training_writes_weights_log_and_checkpoint_and_learns(dataset, tmp_path):
    recipe = Line(epochs=5)
    before = torch.random.get_rng_state()
    path = fit(recipe, *_samples(dataset, recipe), tmp_path / "out", machine=CPU, progress=False)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert path == tmp_path / "out" / "line.safetensors"
    log = (tmp_path / "out" / "log.csv").read_text().splitlines()
    rows = [dict(zip(log[0].split(","), map(float, line.split(",")), strict=True)) for line in log[1:]]
    assert [row["epoch"] for row in rows] == [1.0, 2.0, 3.0, 4.0, 5.0]
    assert rows[-1]["train_loss"] < rows[0]["train_loss"]
    assert 0.5 < rows[0]["val_valid_share"] < 0.7  # grey values are even over 0-255, and 61 % of them above 100
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"line.safetensors", "log.csv", "checkpoint.safetensors"}


@pytest.mark.parametrize(("optimizer", "workers"), [("adam", 0), ("muon", 0), ("adam", 1)])
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_resumed_training_ends_in_the_same_bits(dataset, tmp_path, optimizer, workers):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    machine = Machine(accelerator="cpu", tensorboard=False, workers=workers)
    recipe = Line(optimizer=optimizer)
    fit(recipe, *_samples(dataset, recipe), whole, machine=machine, progress=False)

    class Stop(Exception):  # noqa: N818 - stands for whatever ends a process
        pass

    class Stopping(Line):
        def loss(self, batch, progress):
            if progress > 0.4:  # in the middle of the second epoch
                raise Stop
            return super().loss(batch, progress)

    recipe = Stopping(optimizer=optimizer)
    with pytest.raises(Stop):
        fit(recipe, *_samples(dataset, recipe), parts, machine=machine, progress=False)
    assert len((parts / "log.csv").read_text().splitlines()) == 2
    recipe = Line(seed=0, optimizer=optimizer)
    fit(recipe, *_samples(dataset, recipe), parts, machine=machine, resume=True, progress=False)
    assert _bytes(parts) == _bytes(whole)
    assert len((parts / "log.csv").read_text().splitlines()) == 4


def test_killed_training_ends_in_the_same_bits(dataset, tmp_path):
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    recipe = Line(epochs=6)
    fit(recipe, *_samples(dataset, recipe), whole, machine=CPU, progress=False)
    code = f"""
    import sys, time
    sys.path.insert(0, {str(Path(__file__).parent)!r})
    from pathlib import Path
    import test_fit
    from laploop.perception.data.datasets import open_dataset

    class Slow(test_fit.Line):
        def loss(self, batch, progress):
            time.sleep(60.0 if progress >= 0.5 else 0.0)  # ends by being killed
            return super().loss(batch, progress)

    recipe = Slow(epochs=6)
    samples = test_fit._samples(open_dataset(Path({str(dataset.path)!r})), recipe)
    test_fit.fit(recipe, *samples, Path({str(killed)!r}), machine=test_fit.CPU, progress=False)
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)])  # noqa: S603 - our own interpreter and text
    deadline = time.monotonic() + 120.0
    while process.poll() is None and time.monotonic() < deadline:
        if (killed / "log.csv").is_file() and len((killed / "log.csv").read_text().splitlines()) >= 3:
            break
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    recipe = Line(epochs=6)
    fit(recipe, *_samples(dataset, recipe), killed, machine=CPU, resume=True, progress=False)
    assert _bytes(killed) == _bytes(whole)
    assert [line.split(",")[0] for line in (killed / "log.csv").read_text().splitlines()[1:]] == [f"{n}.0" for n in range(1, 7)]


def test_resuming_a_finished_training_does_nothing(dataset, tmp_path):
    recipe = Line(epochs=1)
    fit(recipe, *_samples(dataset, recipe), tmp_path / "out", machine=CPU, progress=False)
    before = _bytes(tmp_path / "out")
    recipe = Line(epochs=1)
    fit(recipe, *_samples(dataset, recipe), tmp_path / "out", machine=CPU, resume=True, progress=False)
    assert _bytes(tmp_path / "out") == before


def test_training_is_not_overwritten_unasked_nor_resumed_by_another_network(dataset, tmp_path):
    recipe = Line(epochs=1)
    samples = _samples(dataset, recipe)
    fit(recipe, *samples, tmp_path / "out", machine=CPU, progress=False)
    with pytest.raises(OutputError, match="resume"):
        fit(Line(epochs=2), *samples, tmp_path / "out", machine=CPU, progress=False)
    other = Line(epochs=2)
    other.network = torch.nn.Conv2d(1, 1, 3, padding=1)
    with pytest.raises(WeightsError, match="architecture"):
        fit(other, *samples, tmp_path / "out", machine=CPU, resume=True, progress=False)


@pytest.mark.parametrize("content", [b"\x80\x04pickle", b"PK\x03\x04zip", b"no checkpoint at all"])
def test_checkpoint_that_is_a_pickle_or_damaged_is_refused(dataset, tmp_path, content):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "checkpoint.safetensors").write_bytes(content)
    recipe = Line()
    with pytest.raises(WeightsError):
        fit(recipe, *_samples(dataset, recipe), tmp_path / "out", machine=CPU, resume=True, progress=False)


def test_checkpoint_keeps_every_kind_of_value_and_layout(tmp_path):
    from laploop.perception.training.checkpoint_io import SafetensorsCheckpointIO

    last = torch.arange(16.0).reshape(1, 2, 2, 4).contiguous(memory_format=torch.channels_last)
    content = {"a": {0: last, "b": [1, 2.5, None, True, "x", (3, float("inf"))]}, "shared": [last, torch.tensor(7)]}
    plugin = SafetensorsCheckpointIO()
    plugin.save_checkpoint(content, tmp_path / "c")
    read = plugin.load_checkpoint(tmp_path / "c")
    assert read["a"]["b"] == content["a"]["b"]
    assert torch.equal(read["a"][0], last)
    assert read["a"][0].is_contiguous(memory_format=torch.channels_last)
    assert int(read["shared"][1]) == 7
    with pytest.raises(OutputError, match="object"):
        plugin.save_checkpoint({"a": object()}, tmp_path / "d")
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["c"]
    plugin.remove_checkpoint(tmp_path / "c")
    with pytest.raises(MissingFileError, match="resume"):
        plugin.load_checkpoint(tmp_path / "c")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": 4}, "seed is 0; allowed: 4"),
        ({"learning_rate": 5e-3}, r"learning_rate is 0\.01; allowed: 0\.005"),
        ({"batch": 1}, "batch is 2; allowed: 1"),
        ({"optimizer": "muon"}, "optimizer is 'adam'; allowed: 'muon'"),
    ],
)
@pytest.mark.parametrize("epochs", [2, 1])  # before its end, and after it
def test_a_training_with_other_options_is_not_resumed(dataset, tmp_path, changes, named, epochs):
    out = tmp_path / "out"
    recipe = Line(epochs=1)
    fit(recipe, *_samples(dataset, recipe), out, machine=CPU, progress=False)
    before = {path: path.read_bytes() for path in out.iterdir()}
    other = Line(**{"epochs": epochs, **changes})
    with pytest.raises(WeightsError, match=named) as caught:
        fit(other, *_samples(dataset, other), out, machine=CPU, resume=True, progress=False)
    assert "\n" not in str(caught.value)
    assert {path: path.read_bytes() for path in out.iterdir()} == before


def test_a_training_with_other_frames_is_not_resumed_wherever_they_lie(dataset, tmp_path):
    out = tmp_path / "out"
    recipe = Line(epochs=1)
    fit(recipe, *_samples(dataset, recipe), out, machine=CPU, progress=False)
    moved, other = _dataset(tmp_path / "moved"), _dataset(tmp_path / "other", frames=7)
    recipe = Line(epochs=2)
    with pytest.raises(WeightsError, match="content of the training frames"):
        fit(recipe, *_samples(other, recipe), out, machine=CPU, resume=True, progress=False)
    fit(recipe, *_samples(moved, recipe), out, machine=CPU, resume=True, progress=False)
    assert len((out / "log.csv").read_text().splitlines()) == 3


def test_a_machine_that_is_not_there_is_one_clear_line(dataset, tmp_path):
    recipe = Line()
    with pytest.raises(InvalidValueError, match="machine") as caught:
        fit(recipe, *_samples(dataset, recipe), tmp_path / "out", machine=Machine(strategy="no-such"), progress=False)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()


def test_missing_lightning_names_the_extra(monkeypatch):
    monkeypatch.setattr(fit_module, "find_spec", lambda name: None)
    with pytest.raises(InvalidValueError, match=r"laploop\[train\]"):
        fit_module.require_lightning()


def test_bad_frames_are_refused_before_training(tmp_path, dataset):
    with pytest.raises(InvalidValueError, match="reference camera"):
        Samples.read(dataset, "train", Line(), against="zivid")
    with pytest.raises(InvalidValueError, match="split"):
        Samples.read(dataset, "test", Line())


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("depth_mm", lambda depth: np.full_like(depth, np.nan), "frames with any depth"),
        ("depth_mm", lambda depth: depth - 95.0, "smallest depth"),
        ("depth_mm", lambda depth: depth[:16], "shapes"),
        ("image", lambda image: image.astype(np.uint16), "type of the image"),
        ("image", lambda image: image[:, :16], "shapes"),
    ],
)
def test_frame_that_cannot_be_learned_from_is_refused_with_its_trouble(dataset, monkeypatch, name, change, message):
    original = getattr(type(dataset), name)
    monkeypatch.setattr(type(dataset), name, lambda self, index: change(original(self, index)))
    with pytest.raises(InvalidValueError, match=message):
        Samples.read(dataset, "train", Line())
