import shutil

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.data.check import check_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairFrame, PairStore


def test_good_data_set_passes_the_check(store):
    seen = []
    result = check_dataset(store, report=seen.append)
    assert result.passed
    assert (result.frames, result.done) == (7, 7)
    assert seen == list(range(1, 8))


def _cut_off(path):
    chunk = path / "depth_mm" / "c.3.0.0"
    chunk.write_bytes(chunk.read_bytes()[:100])


def _change_a_value(path):
    image = PairStore.open(path, writable=True)._arrays["image"]
    image[3, 0, 0] = 255 - int(image[3, 0, 0])


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: (path / "checksum" / "c.3.0").unlink(), "pair 3: not done"),
        (_cut_off, "pair 3: depth_mm of pair 3"),
        (_change_a_value, "differs from what was written"),
        (lambda path: (path / "depth_mm" / "c.3.0.0").unlink(), "differs from what was written"),
        (lambda path: shutil.copy(path / "image" / "c.2.0.0", path / "image" / "c.3.0.0"), "differs from what was written"),
        (lambda path: (path / "lit" / "c.3.0.0").write_bytes(b""), "pair 3: lit of pair 3"),
    ],
)
def test_check_finds_damage_and_says_where(copied, damage, message):
    damage(copied)
    (problem,) = check_dataset(PairStore.open(copied)).problems
    assert problem.startswith("pair 3: ")
    assert message in problem


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("reference_depth_mm", lambda mm: mm + np.float32(0.5), "its reference depth is not what"),
        ("reference_depth_mm", lambda mm: np.full_like(mm, np.nan), "have a reference depth"),
        ("depth_mm", lambda mm: mm + np.float32(5.0), "differ by"),
        ("projector_x", lambda x: np.full_like(x, np.nan), "finite"),
        ("lit", np.zeros_like, "the projector reaches"),
        ("image", np.zeros_like, "its image is uniform"),
    ],
)
def test_check_finds_what_cannot_be(copied, name, change, message):
    store = PairStore.open(copied, writable=True)
    frame = vars(store.frame(3))
    store.write(3, PairFrame(**{**frame, name: change(frame[name])}), store.metadata(3))
    problems = check_dataset(store).problems
    assert any(message in problem for problem in problems), problems
    assert all(problem.startswith("pair 3: ") for problem in problems)


def test_check_finds_metadata_of_another_pair(copied):
    store = PairStore.open(copied, writable=True)
    store.write(3, store.frame(3), store.metadata(4))
    assert check_dataset(store).problems == ("pair 3: its metadata belong to pair 4",)


def test_check_finds_a_tissue_in_two_splits(tmp_path):
    store = FrameStore.create(
        tmp_path / "frames",
        optics=ScopeOptics(),
        tissue_seed=np.array([0, 1, 1]),
        split=np.array([0, 0, 1], np.uint8),
        tool_in_view=np.zeros(3, bool),
        config={},
    )
    problems = check_dataset(store).problems
    assert problems == ("tissue 1: in more than one split (train, val)", *(f"frame {index}: not done" for index in range(3)))
