import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.main import main
from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.inference.models import load_network
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.compact_unet import within_logit
from laploop.perception.training.confidence import ODDS, Readings, fit_odds, refit_confidence
from laploop.perception.weights import load_weights

START = torch.tensor([0.3, 2.0, 0.0])


@pytest.fixture
def small_dataset(tmp_path, rig, render):
    """Two frames of a rolling surface to validate on."""
    path = tmp_path / "worlds" / "frames.zarr"
    split, none = np.ones(2, np.uint8), np.zeros(2, bool)
    store = FrameStore.create(path, optics=ScopeOptics(), tissue_seed=np.arange(2), split=split, tool_in_view=none, config={})
    x = np.linspace(-1.0, 1.0, 256)
    for index in range(2):
        depth_m = 0.09 + 0.02 * index + 0.006 * np.sin(3.0 * x)[None, :] * np.cos(2.0 * x)[:, None]
        image = render(rig, depth_m, rng=np.random.default_rng(index))
        store.write(index, image=image, depth_mm=(1e3 * depth_m).astype(np.float32), lit=np.ones((256, 256), bool))
    return path


def made_readings(true_odds, families, count=20_000):
    """Make pixels of families, each right as often as its own odds say."""
    rng = torch.Generator().manual_seed(0)
    parts = []
    for number, name in enumerate(families):
        scale = torch.randn(count, generator=rng, dtype=torch.float64)
        rate = torch.sigmoid(within_logit(torch.tensor(true_odds[number], dtype=torch.float64), scale))
        parts.append((scale, (torch.rand(count, generator=rng, dtype=torch.float64) < rate).double(), np.full(count, name)))
    scale, within = (torch.cat([part[place] for part in parts]) for place in (0, 1))
    return Readings(
        log_scale=scale,
        slip=torch.zeros_like(scale),
        within=within,
        error_mm=2.0 * (1.0 - within),
        family=np.concatenate([part[2] for part in parts]),
    )


def test_odds_fall_with_the_scale_everywhere():
    scale = torch.linspace(-4.0, 4.0, 81)
    for odds in ([0.3, 2.0, 0.0], [0.5, 1.9, 0.35], [0.5, 1.9, -0.1]):
        assert (torch.diff(within_logit(torch.tensor(odds), scale)) <= 1e-6).all()


def test_odds_that_made_the_pixels_are_found_again():
    readings = made_readings([[0.6, 1.5, 0.2]], ["folds"])
    found = fit_odds(readings, START)
    difference = readings.confidence(found.double()) - readings.confidence(torch.tensor([0.6, 1.5, 0.2], dtype=torch.float64))
    assert difference.abs().mean() < 0.02


def test_the_family_that_is_right_least_often_weighs_most():
    readings = made_readings([[0.8, 1.8, 0.0], [-0.4, 1.8, 0.0]], ["lobes", "strands"])
    confidence = readings.confidence(fit_odds(readings, START).double())
    beyond = [
        float((confidence - readings.within)[torch.from_numpy(readings.family == name)].mean()) for name in ("lobes", "strands")
    ]
    assert beyond[0] < -0.1
    assert 0.0 < beyond[1] < -0.5 * beyond[0]


def test_the_command_writes_the_same_weights(tmp_path, small_dataset, capsys):
    refit_confidence(NETWORKS.get("compact"), None, small_dataset, tmp_path / "new.safetensors")
    out = tmp_path / "fitted"
    assert main(["export", "--model", "compact", "--confidence", str(small_dataset.parent), "--out", str(out)]) == 0
    one, other = (load_file(path) for path in (tmp_path / "new.safetensors", out / "compact.safetensors"))
    assert torch.equal(one[ODDS], other[ODDS])
    summary = json.loads((out / "summary.json").read_text())
    assert summary["odds"] == pytest.approx(one[ODDS].tolist())
    assert summary["frames"] == 2
    assert main(["export", "--confidence", str(small_dataset), "--random-weights", "--out", str(tmp_path / "no")]) == 2
    assert "none together with average or random_weights" in capsys.readouterr().err
    assert main(["export", "--model", "ssle", "--confidence", str(small_dataset), "--out", str(tmp_path / "no")]) == 2
    assert "one with a confidence: compact or ssle-phase" in capsys.readouterr().err


def test_weights_get_new_odds_and_keep_all_else(tmp_path, small_dataset):
    spec, out = NETWORKS.get("compact"), tmp_path / "new.safetensors"
    found = refit_confidence(spec, None, small_dataset, out)
    rig = open_dataset(small_dataset).rig(0)
    network = load_network(spec, rig, out)
    old, _ = load_weights(spec.weights, network.config.architecture)
    new, notes = load_weights(out, network.config.architecture)
    assert [name for name in new if not torch.equal(old[name], new[name])] == [ODDS]
    assert new[ODDS].tolist() == pytest.approx(found["odds"])
    assert "epoch" in notes
    with pytest.raises(InvalidValueError, match="network is 'ssle'; allowed: one with a confidence"):
        refit_confidence(NETWORKS.get("ssle"), None, small_dataset, out)
