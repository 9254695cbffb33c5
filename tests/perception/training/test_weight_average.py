import pytest
import torch

from laploop.errors import InvalidValueError, WeightsError
from laploop.perception.training.weight_average import average_weights
from laploop.perception.weights import load_weights, save_weights

ARCHITECTURE = {"format": "test"}


def _tensors(value, count):
    return {"kernel": torch.full((2, 3), value), "batches": torch.tensor(count)}


def _file(tmp_path, name, value, count=0):
    path = tmp_path / f"{name}.safetensors"
    save_weights(path, _tensors(value, count), ARCHITECTURE)
    return path


def test_average_counts_every_part_by_its_share(tmp_path):
    parts = [(_file(tmp_path, "a", 1.0, 5), 1.0), (_file(tmp_path, "b", 4.0, 9), 2.0)]
    average_weights(parts, ARCHITECTURE, _tensors(0.0, 0), tmp_path / "out.safetensors")
    average, notes = load_weights(tmp_path / "out.safetensors", ARCHITECTURE, _tensors(0.0, 0))
    assert torch.equal(average["kernel"], torch.full((2, 3), 3.0))
    assert average["kernel"].dtype == torch.float32
    assert int(average["batches"]) == 9
    assert notes["average"] == "a.safetensors: 1, b.safetensors: 2"


def test_nothing_to_average_and_impossible_shares_are_refused(tmp_path):
    one = _file(tmp_path, "a", 1.0)
    for parts, word in (([], "1 or more"), ([(one, 0.0)], "share"), ([(one, float("nan"))], "share")):
        with pytest.raises(InvalidValueError, match=word):
            average_weights(parts, ARCHITECTURE, _tensors(0.0, 0), tmp_path / "out.safetensors")


def test_another_architecture_is_refused_and_nothing_written(tmp_path):
    one, other = _file(tmp_path, "a", 1.0), tmp_path / "b.safetensors"
    save_weights(other, {"kernel": torch.zeros(4)}, ARCHITECTURE)
    with pytest.raises(WeightsError, match="architecture"):
        average_weights([(one, 1.0), (other, 1.0)], ARCHITECTURE, _tensors(0.0, 0), tmp_path / "out.safetensors")
    assert not (tmp_path / "out.safetensors").exists()
