from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset, ReferencedDataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.joined_dataset import JoinedDataset, join
from laploop.perception.geometry import Rig
from laploop.perception.training.samples import check_against

OPTICS = ScopeOptics(width=32, height=32)
SHORT = replace(OPTICS, baseline_m=0.004)


def _store(path, optics, split, grey):
    frames = len(split)
    store = FrameStore.create(
        path,
        optics=optics,
        tissue_seed=np.arange(frames),
        split=np.array(split, np.uint8),
        tool_in_view=np.zeros(frames, bool),
        config={},
    )
    size = (optics.height, optics.width)
    for index in range(frames):
        image = np.full(size, grey + index, np.uint8)
        store.write(index, image=image, depth_mm=image.astype(np.float32), lit=np.ones(size, bool))
    return FrameStore.open(path)


@pytest.fixture
def parts(tmp_path):
    return [_store(tmp_path / "a", OPTICS, [0, 0, 1], 10), _store(tmp_path / "b", SHORT, [0, 1], 20)]


def test_frames_follow_one_another_and_keep_split_and_rig(parts):
    joined = JoinedDataset(parts)
    assert isinstance(joined, DepthDataset)
    assert len(joined) == 5
    assert joined.done().all()
    assert joined.indices("train").tolist() == [0, 1, 3]
    assert joined.indices("val").tolist() == [2, 4]
    assert [int(joined.image(index)[0, 0]) for index in range(5)] == [10, 11, 12, 20, 21]
    assert float(joined.depth_mm(4)[0, 0]) == 21.0
    assert joined.lit(3).all()
    assert [joined.rig(index) for index in (2, 3)] == [Rig.from_optics(OPTICS), Rig.from_optics(SHORT)]


def test_images_of_different_sizes_are_refused(parts, tmp_path):
    other = _store(tmp_path / "c", replace(OPTICS, width=64), [0], 0)
    with pytest.raises(InvalidValueError, match=r"\(32, 64\)"):
        JoinedDataset([*parts, other])


def test_nothing_to_join_and_frames_that_are_not_there_are_refused(parts):
    with pytest.raises(InvalidValueError, match="1 or more"):
        JoinedDataset([])
    with pytest.raises(InvalidValueError, match="0 to 4"):
        JoinedDataset(parts).image(5)


def test_split_may_come_from_one_part_but_not_from_none(parts, tmp_path):
    only_train = _store(tmp_path / "c", OPTICS, [0], 0)
    assert JoinedDataset([*parts, only_train]).indices("val").tolist() == [2, 4]
    with pytest.raises(InvalidValueError, match=r"'val'.*c"):
        JoinedDataset([only_train]).indices("val")


class _Referenced(JoinedDataset, ReferencedDataset):
    def read(self, name, index):
        if name == "reference_depth_mm":
            return super().read("depth_mm", index) + np.float32(0.5)
        return super().read(name, index)


def test_reference_depth_is_joined_where_all_parts_have_it(parts):
    pairs = join([_Referenced([part]) for part in parts])
    assert isinstance(pairs, ReferencedDataset)
    check_against(pairs, "zivid")
    assert [float(pairs.reference_depth_mm(index)[0, 0]) for index in (2, 3)] == [12.5, 20.5]
    mixed = join([_Referenced(parts[:1]), parts[1]])
    assert not isinstance(mixed, ReferencedDataset)
    with pytest.raises(InvalidValueError, match="reference camera"):
        check_against(mixed, "zivid")
    assert join(parts[:1]) is parts[0]
