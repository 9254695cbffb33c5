import json

import pytest
import torch

from laploop.cli.commands.export import ExportArguments
from laploop.cli.main import main
from laploop.errors import InvalidValueError, WeightsError
from laploop.perception.network_specs import NETWORKS
from laploop.perception.networks.configs import CompactConfig
from laploop.perception.training.weight_average import average_weights
from laploop.perception.weights import load_weights, save_weights

COMPACT, ARCHITECTURE = NETWORKS.get("compact"), CompactConfig().architecture


@pytest.fixture
def files(tmp_path):
    """Two files that hold 1 and 4 where numbers are averaged, and 5 and 9 where they are counted."""
    paths = []
    for name, value, count in (("a", 1.0, 5), ("b", 4.0, 9)):
        tensors = {"kernel": torch.full((2, 3), value), "batches": torch.tensor(count)}
        paths.append(tmp_path / f"{name}.safetensors")
        save_weights(paths[-1], tensors, ARCHITECTURE)
    return paths


def test_average_counts_every_part_by_its_share(files, tmp_path):
    average_weights(COMPACT, files, tmp_path / "out.safetensors", shares=(1.0, 2.0))
    average, notes = load_weights(tmp_path / "out.safetensors", ARCHITECTURE)
    assert torch.equal(average["kernel"], torch.full((2, 3), 3.0))
    assert average["kernel"].dtype == torch.float32
    assert int(average["batches"]) == 9
    assert notes["average"] == "a.safetensors: 1, b.safetensors: 2"


def test_nothing_to_average_and_impossible_shares_are_refused(files, tmp_path):
    for paths, shares in (([], ()), (files, (1.0,)), (files, (1.0, 0.0)), (files, (1.0, float("nan")))):
        with pytest.raises(InvalidValueError, match="shares"):
            average_weights(COMPACT, paths, tmp_path / "out.safetensors", shares=shares)


def test_another_architecture_is_refused_and_nothing_written(files, tmp_path):
    save_weights(files[1], {"kernel": torch.zeros(4)}, ARCHITECTURE)
    with pytest.raises(WeightsError, match="architecture"):
        average_weights(COMPACT, files, tmp_path / "out.safetensors")
    assert not (tmp_path / "out.safetensors").exists()


def test_command_writes_the_average(files, tmp_path):
    out = tmp_path / "out"
    average = ["export", "--model", "compact", "--average", *map(str, files)]
    assert main([*average, "--shares", "1", "2", "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {"compact.safetensors", "summary.json"}
    assert json.loads((out / "summary.json").read_text())["parameters"] == 7
    tensors, _ = load_weights(out / "compact.safetensors", ARCHITECTURE)
    assert torch.equal(tensors["kernel"], torch.full((2, 3), 3.0))
    with pytest.raises(InvalidValueError, match="average"):
        ExportArguments(average=tuple(files), random_weights=True, out=out)
