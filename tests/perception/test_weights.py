import pickle

import numpy as np
import pytest
import torch
from laploop.perception.estimators.compact import CompactEstimator

from laploop.errors import LaploopError, MissingFileError, OutputError, WeightsError
from laploop.perception.networks.compact_unet import CompactConfig, CompactUNet
from laploop.perception.weights import load_weights, save_weights

ARCHITECTURE = {"format": "test", "widths": [1, 2]}
TENSORS = {"a": torch.arange(6.0).reshape(2, 3), "b": torch.tensor(3)}


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "weights.safetensors"
    save_weights(path, TENSORS, ARCHITECTURE, {"epoch": "7"})
    return path


def test_what_is_saved_is_loaded(saved):
    tensors, notes = load_weights(saved, ARCHITECTURE, TENSORS)
    assert all(torch.equal(tensors[name], TENSORS[name]) for name in TENSORS)
    assert notes["epoch"] == "7"


def test_header_whose_length_starts_like_a_pickle_is_read(tmp_path):
    path = tmp_path / "weights.safetensors"
    for length in range(0, 2048, 8):  # headers are padded to eight bytes
        save_weights(path, TENSORS, ARCHITECTURE, {"note": "x" * length})
        if path.read_bytes()[0] == 0x80:
            break
    assert path.read_bytes()[0] == 0x80  # the header's length, of which one in 32 ends so
    load_weights(path, ARCHITECTURE, TENSORS)


def test_nothing_but_the_file_is_left_in_the_folder(saved):
    assert [path.name for path in saved.parent.iterdir()] == ["weights.safetensors"]


def test_missing_file_is_named_with_its_path(tmp_path):
    with pytest.raises(MissingFileError, match="nowhere"):
        load_weights(tmp_path / "nowhere.safetensors", ARCHITECTURE, TENSORS)


@pytest.mark.parametrize("keep", [0, 3, 20, -1])
def test_truncated_file_is_refused(saved, keep):
    content = saved.read_bytes()
    saved.write_bytes(content[:keep])
    with pytest.raises(WeightsError, match=r"truncated|not safetensors"):
        load_weights(saved, ARCHITECTURE, TENSORS)


def test_other_architecture_is_refused_and_both_are_named(saved):
    with pytest.raises(WeightsError, match="widths"):
        load_weights(saved, {**ARCHITECTURE, "widths": [1, 3]}, TENSORS)


def test_other_shapes_are_refused(saved):
    with pytest.raises(WeightsError, match="architecture"):
        load_weights(saved, ARCHITECTURE, {**TENSORS, "a": torch.zeros(3, 2)})


def test_nan_in_the_weights_is_refused(tmp_path):
    broken = {**TENSORS, "a": torch.full((2, 3), float("nan"))}
    save_weights(tmp_path / "nan.safetensors", broken, ARCHITECTURE)
    with pytest.raises(WeightsError, match="NaN"):
        load_weights(tmp_path / "nan.safetensors", ARCHITECTURE, TENSORS)


class _Bomb:
    def __reduce__(self):
        return (pytest.fail, ("something was unpickled",))


def test_bare_pickle_is_refused_without_being_opened(tmp_path):
    path = tmp_path / "weights.safetensors"
    path.write_bytes(pickle.dumps(_Bomb()))
    with pytest.raises(WeightsError, match="pickle"):
        load_weights(path, ARCHITECTURE, TENSORS)


def test_torch_archive_is_refused_without_being_opened(tmp_path):
    path = tmp_path / "weights.safetensors"
    torch.save({"a": _Bomb()}, path)
    with pytest.raises(WeightsError, match="pickle"):
        load_weights(path, ARCHITECTURE, TENSORS)


def test_folder_that_cannot_be_made_is_an_output_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        save_weights(tmp_path / "file" / "w.safetensors", TENSORS, ARCHITECTURE)


def test_compact_weights_of_other_widths_are_refused_by_the_estimator(rig, tmp_path):
    config = CompactConfig(widths=(8, 16))
    path = tmp_path / "other.safetensors"
    save_weights(path, CompactUNet(rig, config).state_dict(), config.architecture)
    with pytest.raises(WeightsError, match="widths"):
        CompactEstimator.from_weights(rig, path)


def test_estimator_made_from_saved_weights_is_the_one_that_was_saved(rig, tmp_path):
    torch.manual_seed(1)
    network = CompactUNet(rig, CompactConfig())
    path = tmp_path / "compact.safetensors"
    save_weights(path, network.state_dict(), network.config.architecture)
    image = np.random.default_rng(0).integers(0, 256, (256, 256)).astype(np.uint8)
    loaded = CompactEstimator.from_weights(rig, path).estimate_with_scale(image)[0]
    np.testing.assert_array_equal(loaded, CompactEstimator(rig, network).estimate_with_scale(image)[0])


def test_every_weights_error_is_a_laploop_error_and_a_value_error():
    assert issubclass(WeightsError, LaploopError)
    assert issubclass(WeightsError, ValueError)
