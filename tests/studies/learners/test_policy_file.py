import pytest
import torch
from torch import nn

from laploop.errors import InvalidValueError, MissingFileError, WeightsError
from laploop.studies.learners.policy_file import DESCRIPTION, WEIGHTS, load_weights, read_description, save_policy


@pytest.fixture
def saved(tmp_path):
    torch.manual_seed(0)
    module = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))
    save_policy(module, tmp_path / "policy", {"kind": "test", "sizes": [3, 4]})
    return module, tmp_path / "policy"


def test_a_policy_comes_back_to_the_bit(saved):
    module, folder = saved
    assert read_description(folder) == {"kind": "test", "sizes": [3, 4]}
    other = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4))
    load_weights(other, folder)
    assert all(
        torch.equal(one, two) for one, two in zip(module.state_dict().values(), other.state_dict().values(), strict=True)
    )


def test_no_file_of_a_policy_is_a_pickle_or_a_zip(saved):
    _, folder = saved
    assert sorted(path.name for path in folder.iterdir()) == [DESCRIPTION, WEIGHTS]
    assert all(path.read_bytes()[:2] not in {b"PK", b"\x80\x04"} for path in folder.iterdir())


def test_weights_of_another_module_are_refused(saved):
    with pytest.raises(WeightsError, match="does not fit"):
        load_weights(nn.Linear(3, 4), saved[1])


def test_damaged_weights_are_refused(saved):
    (saved[1] / WEIGHTS).write_bytes(b"\x80\x04no tensors here")
    with pytest.raises(WeightsError, match="holds no weights"):
        load_weights(saved[0], saved[1])


def test_a_missing_policy_is_named(tmp_path):
    with pytest.raises(MissingFileError, match=DESCRIPTION):
        read_description(tmp_path)


@pytest.mark.parametrize("text", ["{", "[1]"])
def test_a_damaged_description_is_refused(saved, text):
    (saved[1] / DESCRIPTION).write_text(text)
    with pytest.raises(InvalidValueError, match="JSON"):
        read_description(saved[1])
