from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import OutputError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.depth.evaluation import evaluate_depth
from laploop.studies.synthesis.config import TrainingFramesConfig
from laploop.studies.synthesis.run import render_training_frames

TINY = TrainingFramesConfig(
    train_tissues=1,
    val_tissues=1,
    test_tissues=1,
    frames_per_tissue=4,
    tool_share=0.75,
    workers=1,
    optics=ScopeOptics(width=64, height=64, mask=StripeMask(stripes=10)),
)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    path = render_training_frames(TINY, tmp_path_factory.mktemp("data") / "frames")
    return FrameStore.open(path)


def test_every_planned_frame_is_done_and_no_tissue_is_in_two_splits(store):
    assert store.done().all()
    assert len(store) == 12
    assert [len(set(store.tissue_seed[store.split == split])) for split in range(3)] == [1, 1, 1]
    assert len(set(store.tissue_seed)) == 3


def test_frames_are_in_range_and_have_light_and_truth(store):
    for index in range(len(store)):
        depth_mm, image = store.depth_mm(index), store.image(index)
        tissue_mm = float(np.nanmedian(depth_mm))
        assert 45.0 < tissue_mm < 190.0
        assert np.isfinite(depth_mm).mean() > 0.5
        assert store.lit(index).mean() > 0.3
        assert image.max() > 10


def test_tool_is_nearer_than_the_tissue_where_it_was_put_into_view(store):
    assert 0.3 < store.tool_in_view.mean() < 1.0
    nearest = np.array([np.nanmin(store.depth_mm(i)) / np.nanmedian(store.depth_mm(i)) for i in range(len(store))])
    assert nearest[store.tool_in_view].mean() < nearest[~store.tool_in_view].mean() - 0.1


def test_frames_of_a_tissue_differ_and_tissues_differ(store):
    images = [store.image(index) for index in range(len(store))]
    assert all(not np.array_equal(images[0], image) for image in images[1:])


def test_lit_pixels_lie_inside_the_mask(store):
    rig = Rig.from_optics(store.optics)
    depth_m = 1e-3 * store.depth_mm(0).astype(np.float64)
    mask_x = rig.projector_x(depth_m)[store.lit(0)]
    assert np.abs(mask_x).max() <= rig.mask.half_width_tan + 1e-5  # tangent; float32 depth


def test_interrupted_rendering_goes_on_to_the_same_frames(store, tmp_path, monkeypatch):
    class Interruption(Exception):  # noqa: N818 - stands for Ctrl-C
        pass

    original, written = FrameStore.write, []

    def interrupted(self, index, **arrays):
        if len(written) == 6:
            raise Interruption
        written.append(index)
        original(self, index, **arrays)

    out = tmp_path / "frames"
    with monkeypatch.context() as patch:
        patch.setattr(FrameStore, "write", interrupted)
        with pytest.raises(Interruption):
            render_training_frames(TINY, out)
    assert FrameStore.open(out).done().sum() == 6
    resumed = FrameStore.open(render_training_frames(TINY, out))
    for index in range(len(store)):
        np.testing.assert_array_equal(resumed.image(index), store.image(index))
        np.testing.assert_array_equal(resumed.depth_mm(index), store.depth_mm(index))


def test_folder_with_another_configuration_is_refused(store):
    with pytest.raises(OutputError, match="another configuration"):
        render_training_frames(replace(TINY, seed=1), store.path)


@pytest.fixture(scope="module")
def unseen(tmp_path_factory):
    config = TrainingFramesConfig(train_tissues=0, val_tissues=0, test_tissues=2, frames_per_tissue=8, workers=1, seed=12345)
    return render_training_frames(config, tmp_path_factory.mktemp("unseen") / "frames")


@pytest.mark.parametrize(("estimator", "promised_mm"), [("phase", 1.5), ("compact", 1.2)])
def test_estimators_keep_their_promise_on_tissues_nobody_has_seen(unseen, estimator, promised_mm):
    row = evaluate_depth(unseen, [estimator], progress=False).row(estimator)
    assert row.valid.mae_mm <= promised_mm
    assert row.valid.acc_1_1 > 0.99
    assert row.valid_fraction > 0.4
