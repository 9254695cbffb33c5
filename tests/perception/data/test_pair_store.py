import errno
import json
from pathlib import Path

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import DatasetError, InvalidValueError, MissingFileError, OutputError
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.datasets import DepthDataset, open_dataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairFrame, PairStore
from laploop.perception.geometry import Intrinsics, Rig
from laploop.perception.reprojection import BrownDistortion, reproject

OPTICS = ScopeOptics(width=32, height=16, mask=StripeMask(stripes=7, phase=0.25))
REGION = Intrinsics(width=24, height=20, fx=80.0, fy=80.0, cx=15.0, cy=7.0)


def _camera(intrinsics):
    poses = np.stack([np.eye(4)] * 5)
    return CameraCalibration(
        intrinsics=intrinsics, distortion=BrownDistortion(), view_errors_px=(0.1,) * 5, camera_from_board=poses
    )


def _stereo():
    transform = np.eye(4)
    transform[:3, 3] = [0.01, -0.02, 0.005]
    return StereoCalibration(
        scope=_camera(Rig.from_optics(OPTICS).camera),
        reference=_camera(REGION),
        scope_from_reference=transform,
        view_errors_px=(0.1,) * 5,
    )


def _create(path):
    return PairStore.create(
        path,
        optics=OPTICS,
        reference_intrinsics=REGION,
        true_scope_from_reference=np.eye(4),
        calibration=_stereo(),
        tissue_seed=np.array([4, 4, 9]),
        split=np.array([0, 0, 2], np.uint8),
        tool_in_view=np.array([True, False, False]),
        config={"seed": 3, "range": [0.1, 0.2]},
    )


@pytest.fixture
def store(tmp_path):
    return _create(tmp_path / "pairs")


def _frame(seed):
    rng = np.random.default_rng(seed)
    scope, region = (16, 32), (20, 24)
    depth_mm, z_mm = rng.uniform(60.0, 140.0, scope).astype(np.float32), rng.uniform(70.0, 90.0, region).astype(np.float32)
    depth_mm[0, 0] = z_mm[3, 3] = np.nan
    lit = rng.random(scope) < 0.5
    return PairFrame(
        image=rng.integers(0, 256, scope, dtype=np.uint8),
        reference_depth_mm=depth_mm + np.float32(0.1),
        depth_mm=depth_mm,
        lit=lit,
        shadow=~lit,
        projector_x=rng.standard_normal(scope, dtype=np.float32),
        projector_y=rng.standard_normal(scope, dtype=np.float32),
        reference_z_mm=z_mm,
        reference_rgba=rng.integers(0, 256, (*region, 4), dtype=np.uint8),
    )


def test_written_pair_is_read_back_to_the_bit(store):
    store.write(1, _frame(7), {"index": 1, "place": [1.5, "a"]})
    opened = PairStore.open(store.path)
    for name, values in vars(_frame(7)).items():
        np.testing.assert_array_equal(getattr(opened.frame(1), name), values, err_msg=name)
    assert opened.metadata(1) == {"index": 1, "place": [1.5, "a"]}


def test_plan_calibration_and_config_come_back(store):
    opened = PairStore.open(store.path)
    assert len(opened) == 3
    assert opened.optics == OPTICS
    assert opened.reference_intrinsics == REGION
    assert opened.config == {"seed": 3, "range": [0.1, 0.2]}
    assert opened.tissue_seed.tolist() == [4, 4, 9]
    assert opened.tool_in_view.tolist() == [True, False, False]
    np.testing.assert_array_equal(opened.true_scope_from_reference, np.eye(4))
    np.testing.assert_array_equal(opened.calibration.scope_from_reference, _stereo().scope_from_reference)
    assert opened.rig(2) == Rig.from_optics(OPTICS)
    with pytest.raises(InvalidValueError, match="0 to 2"):
        opened.rig(3)


def test_pair_that_is_not_done_does_not_exist(store):
    store.write(1, _frame(7), {})
    assert store.done().tolist() == [False, True, False]
    assert store.count_done() == 1
    assert store.indices("train").tolist() == [1]
    with pytest.raises(InvalidValueError, match="test"):
        store.indices("test")
    with pytest.raises(InvalidValueError, match="train, val, test"):
        store.indices("holdout")


def test_cloud_is_reprojected_by_the_calibration_or_by_another_transform(store):
    store.write(0, _frame(1), {})
    cloud = store.reference_cloud_mm(0)
    rays = REGION.rays.astype(np.float32)
    valid = np.isfinite(_frame(1).reference_z_mm)
    np.testing.assert_array_equal(cloud, (rays * _frame(1).reference_z_mm[..., None])[valid])
    assert len(cloud) == 24 * 20 - 1
    for transform in (_stereo().scope_from_reference, np.eye(4)):
        expected = reproject(cloud, transform, Rig.from_optics(OPTICS).camera)
        np.testing.assert_array_equal(store.reproject_with(0, transform).depth_mm, expected.depth_mm)
        assert expected.mask.any()


def test_existing_folder_is_not_overwritten(store):
    with pytest.raises(OutputError, match="exists"):
        _create(store.path)


def test_store_that_was_cut_off_while_being_made_is_made_anew(tmp_path):
    partial = tmp_path / ".pairs.partial"
    partial.mkdir()
    (partial / "zarr.json").write_text("{")
    assert len(_create(tmp_path / "pairs")) == 3
    assert not partial.exists()


def test_what_killed_processes_left_behind_is_removed(store):
    store.write(1, _frame(7), {})
    left = store.path / "image" / "c.0.0.1f.partial"
    left.write_bytes(b"half a chunk")
    counted = store.path / "checksum" / "c.0.2a.partial"
    counted.write_bytes(b"x")
    assert store.count_done() == 1
    store.remove_left_behind()
    assert not left.exists()
    assert not counted.exists()
    store.verify([1])


def test_missing_store_is_named_with_its_path(tmp_path):
    for open_it in (PairStore.open, open_dataset):
        with pytest.raises(MissingFileError, match="nowhere"):
            open_it(tmp_path / "nowhere")


def test_store_without_its_calibration_is_refused(store):
    (store.path / "calibration.json").unlink()
    with pytest.raises(DatasetError, match="calibration"):
        PairStore.open(store.path)


def test_store_of_another_format_is_refused(store):
    text = (store.path / "zarr.json").read_text()
    for other, message in (("pairs-1", "older version; make it anew"), ("pairs-9", "'laploop-pairs-9'")):
        (store.path / "zarr.json").write_text(text.replace("pairs-2", other))
        for open_it in (PairStore.open, open_dataset):
            with pytest.raises(DatasetError, match=message):
                open_it(store.path)


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EROFS])
def test_disk_that_refuses_is_an_error_and_what_was_saved_stays(store, monkeypatch, reason):
    store.write(0, _frame(1), {})
    original = Path.open

    def refuse(self, mode="r", *args, **keywords):
        if "w" in mode and "projector_x" in str(self):
            raise OSError(reason, "the disk refuses")
        return original(self, mode, *args, **keywords)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", refuse)
        with pytest.raises(OutputError, match=r"pair 1.*the disk refuses.*what was saved stays"):
            store.write(1, _frame(2), {})
    opened = PairStore.open(store.path, writable=True)
    assert opened.done().tolist() == [True, False, False]
    opened.verify([0])
    opened.write(1, _frame(2), {})
    opened.verify([0, 1])


def test_folder_that_cannot_be_made_is_an_error():
    # Not even root can make folders there.
    with pytest.raises(OutputError, match="/proc"):
        _create(Path("/proc/laploop/pairs"))


@pytest.mark.parametrize("metadata", [{"long": "x" * 20_000}, {"not": np.nan}, {"set": {1}}])
def test_metadata_that_cannot_be_kept_are_refused(store, metadata):
    with pytest.raises(InvalidValueError, match="metadata of pair 0"):
        store.write(0, _frame(1), metadata)
    assert not store.done().any()


def test_data_sets_are_opened_by_their_format(store, tmp_path):
    frames = FrameStore.create(
        tmp_path / "frames",
        optics=OPTICS,
        tissue_seed=np.array([1]),
        split=np.array([0], np.uint8),
        tool_in_view=np.array([False]),
        config={},
    )
    for path, kind in ((store.path, PairStore), (frames.path, FrameStore)):
        opened = open_dataset(path)
        assert isinstance(opened, kind)
        assert isinstance(opened, DepthDataset)
        assert opened.optics == OPTICS
        assert opened.rig(0).camera == Rig.from_optics(OPTICS).camera
    assert json.loads((store.path / "zarr.json").read_text())["attributes"]["format"] == "laploop-pairs-2"
