import json
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import DatasetError, InvalidValueError, MissingFileError, OutputError
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.integrity import sha256_of_json
from laploop.perception.data.joined_dataset import join
from laploop.perception.geometry import Rig

OPTICS = ScopeOptics(width=32, height=16, mask=StripeMask(stripes=7, phase=0.25))


@pytest.fixture
def store(tmp_path):
    return FrameStore.create(
        tmp_path / "frames",
        optics=OPTICS,
        tissue_seed=np.array([4, 4, 9]),
        split=np.array([0, 0, 2], np.uint8),
        tool_in_view=np.array([True, False, False]),
        config={"seed": 3, "range": [0.1, 0.2]},
    )


def _frame(value):
    depth_mm = np.full((16, 32), 80.0 + value, np.float32)
    depth_mm[0, 0] = np.nan
    return {"image": np.full((16, 32), value, np.uint8), "depth_mm": depth_mm, "lit": np.eye(16, 32, dtype=bool)}


def test_written_frame_is_read_back_to_the_bit(store):
    store.write(1, **_frame(7))
    opened = FrameStore.open(store.path)
    np.testing.assert_array_equal(opened.image(1), _frame(7)["image"])
    np.testing.assert_array_equal(opened.depth_mm(1), _frame(7)["depth_mm"])
    np.testing.assert_array_equal(opened.lit(1), _frame(7)["lit"])


def test_plan_optics_and_config_come_back(store):
    opened = FrameStore.open(store.path)
    assert len(opened) == 3
    assert opened.optics == OPTICS
    assert opened.config == {"seed": 3, "range": [0.1, 0.2]}
    assert opened.tissue_seed.tolist() == [4, 4, 9]
    assert opened.tool_in_view.tolist() == [True, False, False]


def test_frame_that_is_not_done_does_not_exist(store):
    store.write(1, **_frame(7))
    assert store.done().tolist() == [False, True, False]
    assert store.indices("train").tolist() == [1]
    with pytest.raises(InvalidValueError, match="test"):
        store.indices("test")


def test_unknown_split_is_refused(store):
    with pytest.raises(InvalidValueError, match="train, val, test"):
        store.indices("holdout")


def test_existing_folder_is_not_overwritten(store):
    with pytest.raises(OutputError, match="exists"):
        FrameStore.create(
            store.path,
            optics=OPTICS,
            tissue_seed=np.zeros(1, np.int64),
            split=np.zeros(1, np.uint8),
            tool_in_view=np.zeros(1, bool),
            config={},
        )


def test_missing_store_is_named_with_its_path(tmp_path):
    with pytest.raises(MissingFileError, match="nowhere"):
        FrameStore.open(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("other", "message"), [("frames-2", "older version; make it anew"), ("frames-9", "'laploop-frames-9'")]
)
def test_store_of_another_format_is_refused(store, other, message):
    text = (store.path / "zarr.json").read_text()
    (store.path / "zarr.json").write_text(text.replace("frames-4", other))
    with pytest.raises(DatasetError, match=message):
        FrameStore.open(store.path)


def test_one_scope_takes_all_frames_unless_others_are_given(store):
    assert store.rig(0) == store.rig(2) == Rig.from_optics(OPTICS)


def test_each_frame_knows_the_rig_that_took_it(tmp_path):
    other = replace(OPTICS, baseline_m=0.0041, mask=StripeMask(stripes=9, duty=0.47))
    written = _with_scopes(tmp_path, [OPTICS, other], [1, 0, 1])
    store = FrameStore.open(written.path)
    for index, optics in enumerate([other, OPTICS, other]):
        assert store.rig(index) == Rig.from_optics(optics)
    assert store.optics == OPTICS


def test_rig_of_a_frame_that_does_not_exist_is_refused(store):
    with pytest.raises(InvalidValueError, match="0 to 2"):
        store.rig(3)


@pytest.mark.parametrize(
    ("scopes", "scope"),
    [([OPTICS], None), ([OPTICS], [0, 0, 1]), ([OPTICS], [0, 0]), ([replace(OPTICS, width=64)], [0, 0, 0])],
)
def test_scopes_that_do_not_fit_the_frames_are_refused(tmp_path, scopes, scope):
    with pytest.raises(InvalidValueError, match="scope"):
        _with_scopes(tmp_path, scopes, scope)
    assert not (tmp_path / "scopes").exists()


def _with_scopes(tmp_path, scopes, scope):
    return FrameStore.create(
        tmp_path / "scopes",
        optics=OPTICS,
        scopes=scopes,
        scope=None if scope is None else np.array(scope, np.int32),
        tissue_seed=np.array([4, 4, 9]),
        split=np.array([0, 0, 2], np.uint8),
        tool_in_view=np.zeros(3, bool),
        config={},
    )


def test_family_and_texture_of_each_frame_come_back(tmp_path):
    store = FrameStore.create(tmp_path / "worlds", **_plan(family=[0, 0, 1], texture=[1, 1, 0]))
    opened = FrameStore.open(store.path)
    assert [opened.family(index) for index in range(3)] == ["lobes", "lobes", "colon"]
    assert [opened.texture(index) for index in range(3)] == ["vessels", "vessels", "plain"]
    assert opened.tissues_by_family() == {"colon": 1, "lobes": 1}
    assert opened.shown() == ({"lobes", "colon"}, {"plain", "vessels"})
    with pytest.raises(InvalidValueError, match="index of a frame is 3"):
        opened.family(3)


@pytest.mark.parametrize(("name", "index"), [("family", [0, 0, 2]), ("texture", [0, -1, 0]), ("family", [0])])
def test_family_or_texture_without_a_name_is_refused(tmp_path, name, index):
    with pytest.raises(InvalidValueError, match=f"{name} is .* each from 0 to 1"):
        FrameStore.create(tmp_path / "worlds", **_plan(**{name: index}))


def test_set_with_a_held_out_family_is_not_learned_from(store, tmp_path):
    store.check_learnable()
    held_out = FrameStore.create(tmp_path / "worlds", **_plan(family=[0, 0, 1]))
    for dataset in (held_out, join([store, held_out])):
        with pytest.raises(InvalidValueError, match=r"held-out families and textures of .* is 'colon'"):
            dataset.check_learnable()
    assert join([store, held_out]).family(5) == "colon"
    assert join([store, held_out]).texture(0) == "own"


def test_set_of_the_format_before_shows_tissue_in_its_own_texture(store):
    store.write(1, **_frame(7))
    path = store.path / "zarr.json"
    content = json.loads(path.read_text())
    attributes = content["attributes"]
    for name in ("families", "textures", "sha256"):
        del attributes[name]
    for name in ("family", "texture"):
        del attributes["plan"][name]
    attributes["format"] = "laploop-frames-3"
    attributes["sha256"] = sha256_of_json(attributes)
    path.write_text(json.dumps(content))
    for opened in (FrameStore.open(store.path), open_dataset(store.path)):
        assert (opened.family(1), opened.texture(1)) == ("tissue", "own")
        assert opened.shown() == ({"tissue"}, {"own"})
        np.testing.assert_array_equal(opened.image(1), _frame(7)["image"])


def _plan(*, family=(0, 0, 0), texture=(0, 0, 0)):
    return {
        "optics": OPTICS,
        "tissue_seed": np.array([4, 4, 9]),
        "split": np.array([0, 0, 2], np.uint8),
        "tool_in_view": np.zeros(3, bool),
        "config": {},
        "families": ["lobes", "colon"],
        "family": np.array(family, np.int32),
        "textures": ["plain", "vessels"],
        "texture": np.array(texture, np.int32),
    }
