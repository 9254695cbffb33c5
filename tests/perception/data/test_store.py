"""Damage of every kind to a data set, at opening or when what is damaged is read: one line that names it."""

import json
import shutil

import numpy as np
import pytest
import zarr

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import DatasetError, InvalidValueError, LaploopError, MissingFileError, OutputError
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore

OPTICS = ScopeOptics(width=32, height=16)
PLAN = {
    "optics": OPTICS,
    "tissue_seed": np.array([1, 2, 3]),
    "split": np.array([0, 1, 2], np.uint8),
    "tool_in_view": np.array([True, False, True]),
    "config": {"seed": 3},
}


def _frame(value):
    return {
        "image": np.full((16, 32), value, np.uint8),
        "depth_mm": np.full((16, 32), 80.0 + value, np.float32),
        "lit": np.eye(16, 32, dtype=bool),
    }


@pytest.fixture
def path(tmp_path):
    store = FrameStore.create(tmp_path / "frames", **PLAN)
    for index in range(3):
        store.write(index, **_frame(index))
    return store.path


def _edit(path, change):
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def _flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)


DAMAGE_AT_OPENING = {
    "no zarr.json": lambda path: (path / "zarr.json").unlink(),
    "empty zarr.json": lambda path: (path / "zarr.json").write_bytes(b""),
    "truncated zarr.json": lambda path: (path / "zarr.json").write_text((path / "zarr.json").read_text()[:300]),
    "binary zarr.json": lambda path: (path / "zarr.json").write_bytes(bytes(range(256))),
    "deep zarr.json": lambda path: (path / "zarr.json").write_text("[" * 100_000),
    "a list for zarr.json": lambda path: (path / "zarr.json").write_text("[]"),
    "no attributes": lambda path: _edit(path / "zarr.json", lambda content: content.update(attributes={})),
    "attributes of another type": lambda path: _edit(path / "zarr.json", lambda content: content.update(attributes=[1])),
    "no config": lambda path: _edit(path / "zarr.json", lambda content: content["attributes"].pop("config")),
    "another baseline": lambda path: _edit(
        path / "zarr.json", lambda content: content["attributes"]["optics"].update(baseline_m=0.007)
    ),
    "no checksum of the attributes": lambda path: _edit(
        path / "zarr.json", lambda content: content["attributes"].pop("sha256")
    ),
    "no depth": lambda path: shutil.rmtree(path / "depth_mm"),
    "no plan": lambda path: shutil.rmtree(path / "split"),
    "no checksums": lambda path: shutil.rmtree(path / "checksum"),
    "truncated array": lambda path: (path / "image" / "zarr.json").write_text('{"shape": [3,'),
    "another type": lambda path: _edit(path / "depth_mm" / "zarr.json", lambda content: content.update(data_type="float64")),
    "an unknown type": lambda path: _edit(path / "depth_mm" / "zarr.json", lambda content: content.update(data_type="depth")),
    "another shape": lambda path: _edit(path / "image" / "zarr.json", lambda content: content.update(shape=[3, 16, 16])),
    "a huge plan": lambda path: _edit(path / "split" / "zarr.json", lambda content: content.update(shape=[10**15])),
    "a group for an array": lambda path: shutil.copy(path / "zarr.json", path / "lit" / "zarr.json"),
    "missing chunk of the plan": lambda path: (path / "split" / "c" / "0").unlink(),
    "flipped bit in the plan": lambda path: _flip(path / "tissue_seed" / "c" / "0"),
    "empty chunk of the plan": lambda path: (path / "tool_in_view" / "c" / "0").write_bytes(b""),
}

DAMAGE_OF_A_FRAME = {
    "missing chunk": lambda path: (path / "depth_mm" / "c.1.0.0").unlink(),
    "flipped bit": lambda path: _flip(path / "depth_mm" / "c.1.0.0"),
    "truncated chunk": lambda path: (path / "depth_mm" / "c.1.0.0").write_bytes(
        (path / "depth_mm" / "c.1.0.0").read_bytes()[:9]
    ),
    "empty chunk": lambda path: (path / "depth_mm" / "c.1.0.0").write_bytes(b""),
    "overwritten chunk": lambda path: (path / "depth_mm" / "c.1.0.0").write_bytes(bytes(range(256))),
    "chunk of another frame": lambda path: shutil.copy(path / "depth_mm" / "c.2.0.0", path / "depth_mm" / "c.1.0.0"),
    "chunk of another array": lambda path: shutil.copy(path / "lit" / "c.1.0.0", path / "depth_mm" / "c.1.0.0"),
    "a folder for a chunk": lambda path: ((path / "depth_mm" / "c.1.0.0").unlink(), (path / "depth_mm" / "c.1.0.0").mkdir()),
    "flipped checksum": lambda path: _flip(path / "checksum" / "c.1.0"),
    "checksum of another frame": lambda path: shutil.copy(path / "checksum" / "c.2.0", path / "checksum" / "c.1.0"),
    "other codecs": lambda path: _edit(path / "depth_mm" / "zarr.json", lambda content: content["codecs"].pop(1)),
    "other chunks": lambda path: _edit(
        path / "depth_mm" / "zarr.json", lambda c: c["chunk_grid"]["configuration"].update(chunk_shape=[3, 16, 32])
    ),
}


@pytest.mark.parametrize("damage", DAMAGE_AT_OPENING.values(), ids=DAMAGE_AT_OPENING)
def test_damaged_store_is_not_opened(path, damage):
    damage(path)
    for open_it in (FrameStore.open, open_dataset):
        with pytest.raises(LaploopError, match="frames") as caught:
            open_it(path)
        assert "\n" not in str(caught.value)
        assert isinstance(caught.value, DatasetError | MissingFileError)


@pytest.mark.parametrize("damage", DAMAGE_OF_A_FRAME.values(), ids=DAMAGE_OF_A_FRAME)
def test_damaged_frame_is_not_read(path, damage):
    damage(path)
    store = open_dataset(path)
    for read in (lambda: store.depth_mm(1), lambda: store.verify(store.indices("val"))):
        with pytest.raises(DatasetError, match="frame 1 of") as caught:
            read()
        assert "\n" not in str(caught.value)


def test_frames_beside_a_damaged_one_are_read(path):
    DAMAGE_OF_A_FRAME["flipped bit"](path)
    store = open_dataset(path)
    store.verify([0, 2])
    np.testing.assert_array_equal(store.depth_mm(2), _frame(2)["depth_mm"])


def test_what_is_no_data_set_is_said_to_be_none(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "empty").mkdir()
    zarr.create_group(tmp_path / "foreign", attributes={"format": ["other"]})
    zarr.create_group(tmp_path / "old", zarr_format=2)
    zarr.create_array(tmp_path / "array", shape=(3,), dtype="uint8")
    expected = {
        "file": "is a file; allowed: a folder that `laploop synthesize`, `laploop collect` or `laploop import-pairs` wrote",
        "empty": "data set not found",
        "nowhere": "data set not found",
        "old": "data set not found",
        "foreign": "has the format",
        "array": "cannot be used",
        "n" * 300: "cannot be used: ",
        "file/inside": "data set not found",
    }
    for name, message in expected.items():
        with pytest.raises(LaploopError, match=message) as caught:
            open_dataset(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_store_appears_whole_or_not_at_all(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Group, "create_array", fail)
        with pytest.raises(OutputError, match="No space left"):
            FrameStore.create(tmp_path / "frames", **PLAN)
    assert list(tmp_path.iterdir()) == []
    assert not FrameStore.create(tmp_path / "frames", **PLAN).done().any()


def test_plan_whose_parts_differ_in_length_is_refused(tmp_path):
    with pytest.raises(InvalidValueError, match="all alike"):
        FrameStore.create(tmp_path / "frames", **{**PLAN, "tissue_seed": np.zeros(4, np.int64)})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "change",
    [{"image": np.zeros((16, 32))}, {"depth_mm": np.zeros((16, 16), np.float32)}, {"lit": np.array(True)}],
)
def test_arrays_of_another_type_or_shape_are_not_written(path, change):
    store = FrameStore.open(path, writable=True)
    with pytest.raises(InvalidValueError, match=f"type and shape of {next(iter(change))}"):
        store.write(1, **{**_frame(7), **change})
    np.testing.assert_array_equal(store.image(1), _frame(1)["image"])


def test_every_bit_of_a_frame_is_kept(path):
    """Even a depth map in which nothing was hit, with the negative NaN that a processor makes."""
    nothing = -np.full((16, 32), np.nan, np.float32)
    store = FrameStore.open(path, writable=True)
    store.write(1, **{**_frame(0), "depth_mm": nothing})
    assert FrameStore.open(path).depth_mm(1).tobytes() == nothing.tobytes()
