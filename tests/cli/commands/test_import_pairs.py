"""What `laploop collect` took, put into files as a bench would have them, is measured as the original is."""

import json

import pytest
from bench_files import write_exact_calibration, write_pairs

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.cli.main import main
from laploop.perception.data.pair_store import PairStore

OPTICS = ScopeOptics(width=128, height=128, mask=StripeMask(stripes=10))
SMALL = ["--pairs", "8", "--tissues", "4", "--split-tissues", "1", "1", "2", "--workers", "1", "--seed", "2"]
SMALL += ["--bench.scope.width", "128", "--bench.scope.height", "128", "--bench.scope.mask.stripes", "10"]
SMALL += ["--bench.reference.sampling", "4x4", "--tissue.cells", "4", "4", "--tissue.shape.samples", "31"]


@pytest.fixture(scope="module")
def collected(tmp_path_factory):
    """A collection with the calibration of a bench that was measured without error."""
    root = tmp_path_factory.mktemp("bench")

    write_exact_calibration(root / "calibration.json", OPTICS)
    arguments = [*SMALL, "--calibration", str(root / "calibration.json"), "--out", str(root / "collected")]
    assert main(["collect", *arguments]) == 0
    return root


@pytest.fixture(scope="module")
def own(collected):
    """The layout of docs/own_images.md."""
    folder = collected / "own"
    write_pairs(folder, PairStore.open(collected / "collected" / "pairs.zarr"))
    arguments = ["--folder", str(folder), "--calibration", str(collected / "calibration.json"), "--unit", "mm"]
    assert main(["import-pairs", *arguments, "--out", str(collected / "imported")]) == 0
    return collected / "imported"


def evaluated(data, out, *more):
    assert main(["evaluate", "--dataset", str(data), "--models", "phase", "--against", "zivid", *more, "--out", str(out)]) == 0
    return json.loads((out / "summary.json").read_text())


def test_summary_counts_pairs_and_scenes(own):
    summary = json.loads((own / "summary.json").read_text())
    assert (summary["command"], summary["pairs"]) == ("import-pairs", 8)
    assert summary["scenes"] == {"train": 1, "val": 1, "test": 2}
    assert 0.3 < summary["reference_share"] <= 1.0


def test_evaluation_finds_the_numbers_of_the_original(collected, own, tmp_path):
    residual = ("--residual-mm", "1", "--residual-deg", "0.1")
    original = evaluated(collected / "collected", tmp_path / "original", *residual)
    imported = evaluated(own, tmp_path / "imported", *residual)
    before, after = (
        next(row for row in summary["rows"] if row["model"] == "phase" and row["working_distance_mm"] == "all")
        for summary in (original, imported)
    )
    assert after["frames"] == before["frames"] == 4
    assert after["pixels"] == before["pixels"] > 20_000
    # Nobody knows what the projector reaches in a real scene.
    assert after["lit_share"] == 0.0
    numbers = {name: value for name, value in before.items() if isinstance(value, float) and not name.startswith("lit_")}
    assert len(numbers) > 20
    assert {name: after[name] for name in numbers} == pytest.approx(numbers, rel=1e-5, abs=1e-7)


def test_exact_depth_is_refused_clearly(own, tmp_path, capsys):
    for arguments, message in (
        (["--against", "exact"], "allowed: zivid: the data set"),
        (["--against", "both"], "allowed: zivid: the data set"),
        (["--against", "zivid", "--models", "oracle"], "has no exact depth for it"),
    ):
        assert main(["evaluate", "--dataset", str(own), "--models", "phase", *arguments, "--out", str(tmp_path / "new")]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "new").exists()
    assert main(["collect", "--verify", str(own)]) == 0


def test_a_network_learns_from_imported_pairs(own, tmp_path, capsys):
    pairs = ["--model", "compact", "--epochs", "1", "--batch", "2", "--dataset", str(own)]
    assert main(["train", *pairs, "--against", "zivid", "--out", str(tmp_path / "new")]) == 0
    assert (tmp_path / "new" / "compact.safetensors").is_file()
    assert main(["train", *pairs, "--against", "exact", "--out", str(tmp_path / "other")]) == 2
    assert "pairs of a real bench have no exact depth" in capsys.readouterr().err
