from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.projector import designed_projector
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.check import check_dataset
from laploop.perception.data.datasets import open_dataset
from laploop.perception.data.imported_pair_store import ImportedPairStore
from laploop.perception.data.joined_dataset import join
from laploop.perception.data.pair_import import PairImport, PairImporter
from laploop.perception.geometry import Intrinsics, Rig, invert_transform, transform_points
from laploop.perception.reprojection import BrownDistortion, reproject
from laploop.perception.training.samples import check_against

OPTICS = ScopeOptics(width=64, height=48, mask=StripeMask(stripes=10))
RIG = Rig.from_optics(OPTICS)
REGION = Intrinsics(width=200, height=160, fx=400.0, fy=400.0, cx=100.0, cy=80.0)


def camera(intrinsics, distortion=None):
    poses = np.tile(np.eye(4), (5, 1, 1))
    distortion = distortion or BrownDistortion()
    return CameraCalibration(intrinsics=intrinsics, distortion=distortion, view_errors_px=(0.1,) * 5, camera_from_board=poses)


def stereo(distortion=None):
    transform = np.eye(4)
    transform[:3, 3] = [0.02, -0.01, -0.2]
    return StereoCalibration(
        scope=camera(RIG.camera, distortion),
        reference=camera(REGION),
        scope_from_reference=transform,
        view_errors_px=(0.1,) * 5,
    )


def cloud_of(depth_m):
    """Points in the reference's frame, metres, one in the middle of each of the scope's pixels and four around it."""
    rays = np.concatenate([RIG.camera.rays.reshape(-1, 3) + [dx, dy, 0.0] for dx in (0.0, 1e-3) for dy in (0.0, 1e-3)])
    return transform_points(invert_transform(stereo().scope_from_reference), depth_m * rays)


@pytest.fixture
def folder(tmp_path):
    """Three planes of two scenes, with random pictures."""
    root = tmp_path / "bench"
    (root / "images").mkdir(parents=True)
    (root / "clouds").mkdir()
    lines = ["image,cloud,split,scene,tool"]
    for number, (depth_m, split, scene) in enumerate(((0.08, "train", "a"), (0.1, "train", "a"), (0.12, "test", "b"))):
        image = np.random.default_rng(number).integers(0, 256, (48, 64), dtype=np.uint8)
        cv2.imwrite(str(root / "images" / f"{number}.png"), image)
        (root / "clouds" / f"{number}.ply").write_bytes(trimesh.PointCloud(1e3 * cloud_of(depth_m)).export(file_type="ply"))
        lines.append(f"images/{number}.png,clouds/{number}.ply,{split},{scene},{int(scene == 'b')}")
    (root / "pairs.csv").write_text("\n".join(lines) + "\n")
    save_calibration(root / "calibration.json", stereo(), projector=designed_projector(RIG), mask=OPTICS.mask)
    return root


def import_from(folder, out, **options):
    importer = PairImporter(PairImport(folder=folder, calibration=folder / "calibration.json", **{"unit": "mm", **options}))
    importer.check()
    return importer.write(out)


def test_imported_pairs_hold_images_plan_rig_and_reprojected_clouds(folder, tmp_path):
    import_from(folder, tmp_path / "pairs")
    store = open_dataset(tmp_path / "pairs")
    assert isinstance(store, ImportedPairStore)
    assert not store.has_exact
    assert store.done().all()
    assert store.rig(0) == RIG
    assert store.optics.mask == OPTICS.mask
    assert store.split.tolist() == [0, 0, 2]
    assert store.tissue_seed.tolist() == [0, 0, 1]
    assert store.tool_in_view.tolist() == [False, False, True]
    for index, depth_mm in enumerate((80.0, 100.0, 120.0)):
        expected = np.random.default_rng(index).integers(0, 256, (48, 64), dtype=np.uint8)
        np.testing.assert_array_equal(store.image(index), expected)
        np.testing.assert_allclose(store.reference_depth_mm(index), depth_mm, atol=1e-3)
        anew = reproject(store.reference_cloud_mm(index), stereo().scope_from_reference, RIG.camera)
        np.testing.assert_array_equal(store.reference_depth_mm(index), anew.depth_mm)
    assert store.metadata(2) == {"index": 2, "image": "2.png", "cloud": "2.ply", "scene": "b"}


def test_there_is_no_exact_depth_to_read_or_to_learn(folder, tmp_path):
    store = import_from(folder, tmp_path / "pairs")
    for read in (store.depth_mm, store.lit):
        with pytest.raises(InvalidValueError, match="the pairs are real"):
            read(0)
    for dataset in (store, join([store, store])):
        check_against(dataset, "zivid")
        with pytest.raises(InvalidValueError, match="'exact'; allowed: zivid; pairs of a real bench have no exact depth"):
            check_against(dataset, "exact")


def test_metres_are_metres_and_a_wrong_unit_is_noticed(folder, tmp_path):
    for number, depth_m in enumerate((0.08, 0.1, 0.12)):
        np.savez(folder / "clouds" / f"{number}.npz", xyz=cloud_of(depth_m))
    lines = (folder / "pairs.csv").read_text()
    (folder / "pairs.csv").write_text(lines.replace(".ply", ".npz"))
    store = import_from(folder, tmp_path / "pairs", unit="m")
    np.testing.assert_allclose(store.reference_depth_mm(1), 100.0, atol=1e-3)
    with pytest.raises(InvalidValueError, match="is the unit mm"):
        import_from(folder, tmp_path / "other", unit="mm")
    (folder / "pairs.csv").write_text(lines)
    with pytest.raises(InvalidValueError, match=r"is the unit m\?"):
        import_from(folder, tmp_path / "other", unit="m")
    assert not (tmp_path / "other").exists()


def test_a_distorted_lens_becomes_a_pinhole_in_image_and_calibration(folder, tmp_path):
    lens = BrownDistortion(k1=-0.1)
    save_calibration(folder / "calibration.json", stereo(lens), projector=designed_projector(RIG), mask=OPTICS.mask)
    grey = np.add.outer(np.zeros(48), np.arange(64) * 3).astype(np.uint8)
    cv2.imwrite(str(folder / "images" / "0.png"), grey)
    store = import_from(folder, tmp_path / "pairs")
    assert store.calibration.scope.distortion == BrownDistortion()
    image = store.image(0).astype(int)
    assert image[24, 32] == pytest.approx(grey[24, 32], abs=2)
    # A barrel shows the corners closer to the middle than a pinhole would.
    assert image[2, 2] > int(grey[2, 2]) + 2
    np.testing.assert_allclose(store.reference_depth_mm(0), 80.0, atol=1e-3)


def test_an_interrupted_import_goes_on_and_another_is_refused(folder, tmp_path):
    store = import_from(folder, tmp_path / "pairs")
    before = store.reference_depth_mm(1)
    (tmp_path / "pairs" / "checksum" / "c.1.0").unlink()
    again = import_from(folder, tmp_path / "pairs")
    assert again.done().all()
    np.testing.assert_array_equal(again.reference_depth_mm(1), before)
    with pytest.raises(OutputError, match="an import of other files or options"):
        import_from(folder, tmp_path / "pairs", bits=12)


def test_check_finds_what_does_not_belong_together(folder, tmp_path):
    store = import_from(folder, tmp_path / "pairs")
    assert check_dataset(store).passed
    pair = {"image": store.image(0), "reference_xyz_mm": store.reference_cloud_mm(0), "metadata": {"index": 1}}
    store.write(0, reference_depth_mm=store.reference_depth_mm(2), **pair)
    problems = " ".join(check_dataset(store).problems)
    assert "its metadata belong to pair 1" in problems
    assert "not what the stored cloud and calibration give" in problems


def test_bad_files_and_calibrations_are_refused_before_anything_is_written(folder, tmp_path):
    def refused(message):
        with pytest.raises(InvalidValueError, match=message):
            import_from(folder, tmp_path / "pairs")
        assert not (tmp_path / "pairs").exists()

    kept = (folder / "images" / "2.png").read_bytes()
    (folder / "images" / "2.png").write_bytes(kept[:300])
    refused(r"2\.png.*a whole PNG")
    (folder / "images" / "2.png").write_bytes(kept)
    behind = cloud_of(0.12) + [0.0, 0.0, -5.0]
    (folder / "clouds" / "2.ply").write_bytes(trimesh.PointCloud(1e3 * behind).export(file_type="ply"))
    refused(r"points of .*2\.ply in the scope's view is 0")
    path, projector = folder / "calibration.json", designed_projector(RIG)
    save_calibration(path, stereo(), mask=OPTICS.mask)
    refused("one with a section projector")
    save_calibration(path, stereo().scope, projector=projector)
    refused("cameras.reference")
    save_calibration(path, stereo(), projector=projector, mask=StripeMask(stripes=10, profile=(0.0, 1.0) * 10))
    refused("networks read no drawn mask")
    odd = replace(stereo(), scope=camera(replace(RIG.camera, width=63)))
    save_calibration(path, odd, projector=projector, mask=OPTICS.mask)
    refused("width is 63")
