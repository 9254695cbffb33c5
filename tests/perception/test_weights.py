import json
import pickle

import numpy as np
import pytest
import torch

from laploop.errors import LaploopError, MissingFileError, OutputError, WeightsError
from laploop.perception.estimators import make_estimator
from laploop.perception.estimators.network import PhaseNetworkEstimator
from laploop.perception.inference.models import load_network
from laploop.perception.network_specs import NETWORKS, SHIPPED
from laploop.perception.networks.compact_unet import CompactUNet
from laploop.perception.networks.configs import CompactConfig
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


def test_estimator_made_from_saved_weights_is_the_one_that_was_saved(rig, tmp_path):
    torch.manual_seed(1)
    network = CompactUNet(CompactConfig(widths=(8, 16)))
    path = tmp_path / "compact.safetensors"
    save_weights(path, network.state_dict(), network.config.architecture)
    image = np.random.default_rng(0).integers(0, 256, (256, 256)).astype(np.uint8)
    loaded, saved = make_estimator("compact", rig, path).estimate(image), PhaseNetworkEstimator(rig, network).estimate(image)
    np.testing.assert_array_equal(loaded.depth_mm, saved.depth_mm)
    np.testing.assert_array_equal(loaded.valid, saved.valid)


def _with_header(path, architecture):
    """Write weights of `compact` under another description, given as text."""
    spec = NETWORKS.get("compact")
    content = spec.weights.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    header["__metadata__"]["architecture"] = architecture
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + content[8 + length :])


DESCRIBED = {"format": "laploop-compact-2", "widths": [32, 48, 64, 96, 128], "windows": [[0.6, 2.0], [0.35, 1.0]]}


@pytest.mark.parametrize(
    "architecture",
    [
        "null",
        "text",
        '"text"',
        "[]",
        "{}",
        "[" * 100_000,
        json.dumps({**DESCRIBED, "format": None}),
        json.dumps({**DESCRIBED, "format": "laploop-ssle-1"}),
        json.dumps({**DESCRIBED, "format": ["x" * 10_000]}),
        json.dumps({**DESCRIBED, "widths": None}),
        json.dumps({**DESCRIBED, "widths": "32"}),
        json.dumps({**DESCRIBED, "widths": []}),
        json.dumps({**DESCRIBED, "widths": [32, 10**9]}),
        json.dumps({**DESCRIBED, "widths": [32.5, 48]}),
        json.dumps({**DESCRIBED, "widths": [True, False]}),
        json.dumps({**DESCRIBED, "widths": [32, 48, 64, 96]}),
        json.dumps({**DESCRIBED, "windows": [[float("nan"), 1.0]]}),
        json.dumps({**DESCRIBED, "windows": [[-1.0, 1.0]]}),
        json.dumps(DESCRIBED).replace("0.35", "1e400"),
        json.dumps(DESCRIBED).replace("[32,", "[" * 500 + "]" * 500 + ", [32,"),
        json.dumps({**DESCRIBED, "note": "line\nline"}),
        json.dumps({"format": "laploop-compact-2"}),
    ],
)
def test_a_damaged_description_is_one_clear_line(rig, tmp_path, architecture):
    path = tmp_path / "weights.safetensors"
    _with_header(path, architecture)
    with pytest.raises(WeightsError, match=r"weights\.safetensors") as caught:
        make_estimator("compact", rig, path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_weights_of_every_other_network_are_refused(rig):
    for spec in SHIPPED:
        for other in SHIPPED:
            if other is not spec:
                with pytest.raises(WeightsError, match=other.config.form):
                    load_network(spec, rig, other.weights)


def test_truncated_weights_of_a_network_are_refused(rig, tmp_path):
    content = NETWORKS.get("compact").weights.read_bytes()
    path = tmp_path / "weights.safetensors"
    for keep in (0, 1, 7, 8, 9, 100, 1000, 5000, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:keep])
        with pytest.raises(WeightsError, match=r"truncated or not safetensors") as caught:
            make_estimator("compact", rig, path)
        assert "\n" not in str(caught.value)


def test_every_weights_error_is_a_laploop_error_and_a_value_error():
    assert issubclass(WeightsError, LaploopError)
    assert issubclass(WeightsError, ValueError)
