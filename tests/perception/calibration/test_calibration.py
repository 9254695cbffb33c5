import json
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError, MissingFileError, OutputError
from laploop.perception.calibration import board_corners
from laploop.perception.calibration.board_corners import find_corners
from laploop.perception.calibration.calibration_file import (
    CalibrationRecord,
    load_calibration,
    load_record,
    save_calibration,
)
from laploop.perception.calibration.hand_eye import HandEyeCalibration
from laploop.perception.calibration.projector import UNKNOWNS, ProjectorCalibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration, transform_residual
from laploop.perception.calibration.solve import calibrate_camera
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points
from laploop.perception.reprojection import BrownDistortion

BOARD = CalibrationBoard()
SCOPE = Intrinsics(width=256, height=256, fx=223.1, fy=219.4, cx=130.3, cy=126.2)
REFERENCE = Intrinsics(width=640, height=480, fx=610.0, fy=611.0, cx=317.0, cy=244.0)


def pose(angles_deg, shift_m):
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    transform[:3, 3] = shift_m
    return transform


SCOPE_FROM_REFERENCE = pose((4.0, 28.0, -6.0), (-0.09, 0.004, 0.015))


def board_poses(count, seed=1, tilt_deg=30.0):
    """Poses of the board in front of the scope's camera, its middle on the axis or near."""
    rng = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        transform = pose(rng.uniform(-tilt_deg, tilt_deg, 3), np.zeros(3))
        middle = [*rng.uniform(-0.01, 0.01, 2), rng.uniform(0.07, 0.12)]
        transform[:3, 3] = middle - transform[:3, :3] @ BOARD.centre
        poses.append(transform)
    return poses


def camera(intrinsics, distortion=None, count=5):
    return CameraCalibration(
        intrinsics=intrinsics,
        distortion=distortion or BrownDistortion(),
        view_errors_px=(0.1,) * count,
        camera_from_board=np.tile(np.eye(4), (count, 1, 1)),
    )


def corners_in(model, poses):
    return [model.project(transform_points(transform, BOARD.corners)) for transform in poses]


def draw(model, camera_from_board, oversampling=4):
    """Picture of the board in closed form: samples of each pixel, cast on the board's plane, and a lens's blur."""
    k = model.intrinsics
    steps = (np.arange(oversampling) + 0.5) / oversampling
    u = (np.arange(k.width)[:, None] + steps).ravel()
    v = (np.arange(k.height)[:, None] + steps).ravel()
    rays = np.stack([*np.meshgrid((u - k.cx) / k.fx, (v - k.cy) / k.fy), np.ones((len(v), len(u)))], axis=-1)
    board_from_camera = invert_transform(camera_from_board)
    directions, origin = rays @ board_from_camera[:3, :3].T, board_from_camera[:3, 3]
    x, y = np.moveaxis(origin[:2] - directions[..., :2] * (origin[2] / directions[..., 2:]), -1, 0) / (1e-3 * BOARD.square_mm)
    column, row = np.floor(x).astype(int) + 1, np.floor(y).astype(int) + 1
    on_squares = (column >= 0) & (column < BOARD.columns) & (row >= 0) & (row < BOARD.rows)
    grey = np.where(on_squares & ((column + row) % 2 == 0), 20.0, 160.0)
    grey[(np.abs(x + 1.0 - 4.0) > 5.0) | (np.abs(y + 1.0 - 3.5) > 4.5)] = 5.0
    pixels = grey.reshape(k.height, oversampling, k.width, oversampling).mean(axis=(1, 3))
    return gaussian_filter(pixels, 0.7).round().astype(np.uint8)  # the lens's blur


@pytest.fixture(scope="module")
def stereo():
    """A calibration such as exact corners give."""
    poses = np.array(board_poses(8))
    reference = replace(
        camera(REFERENCE), camera_from_board=invert_transform(SCOPE_FROM_REFERENCE) @ poses, view_errors_px=(0.01,) * 8
    )
    return StereoCalibration(
        scope=replace(camera(SCOPE), camera_from_board=poses, view_errors_px=(0.02,) * 8),
        reference=reference,
        scope_from_reference=SCOPE_FROM_REFERENCE,
        view_errors_px=(0.03,) * 8,
    )


@pytest.mark.parametrize("turn_deg", [0.0, 80.0, 170.0, 260.0])
def test_corners_are_found_in_order_however_the_board_is_turned(turn_deg):
    turned = pose((12.0, -15.0, turn_deg), (0.0, 0.0, 0.0))
    turned[:3, 3] = [0.002, -0.003, 0.09] - turned[:3, :3] @ BOARD.centre
    model = camera(SCOPE)
    found = find_corners(draw(model, turned), BOARD)
    # Without noise, from pixels a lens blurs: a fifth of a pixel at the worst corner (where edges run along the rows and all
    # their pixels err alike), and no shift of all, which a mistaken pixel centre would make.
    error = found - corners_in(model, [turned])[0]
    assert np.abs(error).max() < 0.2
    assert np.abs(error.mean(axis=0)).max() < 0.03


@pytest.mark.parametrize("shift", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_grid_that_takes_the_outline_of_the_squares_for_corners_is_refused(monkeypatch, shift):
    """The detector does that now and then, and one such view spoils a calibration."""
    turned = pose((12.0, -15.0, 40.0), (0.0, 0.0, 0.0))
    turned[:3, 3] = [0.0, 0.0, 0.09] - turned[:3, :3] @ BOARD.centre
    model = camera(SCOPE)
    step = 1e-3 * BOARD.square_mm * np.array([*shift, 0.0])
    across, down = BOARD.corner_grid
    for offset, is_found in ((np.zeros(3), True), (step, False)):
        grid = model.project(transform_points(turned, BOARD.corners + offset)).reshape(down, across, 2) - 0.5
        monkeypatch.setattr(board_corners, "_find_grid", lambda *_, grid=grid: grid.astype(np.float32))
        assert (find_corners(draw(model, turned), BOARD) is not None) == is_found


def test_colour_pictures_give_the_same_corners():
    grey = draw(camera(SCOPE), board_poses(1)[0])
    alpha = np.full_like(grey, 255)
    np.testing.assert_array_equal(
        find_corners(np.dstack([grey, grey, grey, alpha]), BOARD),
        find_corners(grey, BOARD),
    )


def test_board_that_is_partly_hidden_is_not_found():
    hidden = draw(camera(SCOPE), board_poses(1)[0], oversampling=2)
    hidden[:, :130] = 0
    assert find_corners(hidden, BOARD) is None


def test_what_is_no_picture_is_refused():
    with pytest.raises(InvalidValueError, match=r"float64 of shape \(256, 256\)"):
        find_corners(np.zeros((256, 256)), BOARD)


def test_exact_corners_give_exact_intrinsics_and_poses():
    poses = board_poses(10)
    found = calibrate_camera(corners_in(camera(SCOPE), poses), BOARD, width=256, height=256)
    for name in ("fx", "fy", "cx", "cy"):
        # OpenCV takes corners as 32-bit floats, good for 1e-5 px each.
        assert getattr(found.intrinsics, name) == pytest.approx(getattr(SCOPE, name), rel=1e-6)
    assert (found.intrinsics.width, found.intrinsics.height) == (256, 256)
    assert found.error_px < 1e-4
    np.testing.assert_allclose(found.camera_from_board, poses, atol=1e-6)


def test_distortion_is_found_where_there_is_some():
    true = BrownDistortion(k1=-0.21, k2=0.07, p1=0.002, p2=-0.001)
    found = calibrate_camera(corners_in(camera(SCOPE, true), board_poses(20)), BOARD, width=256, height=256)
    for name in ("k1", "k2", "p1", "p2"):
        assert getattr(found.distortion, name) == pytest.approx(getattr(true, name), abs=1e-4)
    assert found.intrinsics.fx == pytest.approx(SCOPE.fx, rel=1e-5)


def test_distortion_that_cannot_be_seen_is_left_out():
    rng = np.random.default_rng(4)
    noisy = [view + 0.05 * rng.standard_normal(view.shape) for view in corners_in(camera(SCOPE), board_poses(20))]
    found = calibrate_camera(noisy, BOARD, width=256, height=256)
    assert found.distortion == BrownDistortion()
    # Two coordinates of 0.05 px a corner.
    assert found.error_px == pytest.approx(0.05 * math.sqrt(2.0), rel=0.1)
    free = calibrate_camera(noisy, BOARD, width=256, height=256, coefficients=("k1", "k2", "p1", "p2"))
    assert free.distortion.k1 != 0.0
    assert free.distortion.p2 != 0.0


def test_a_simple_barrel_keeps_only_its_first_coefficient():
    rng = np.random.default_rng(4)
    exact = corners_in(camera(SCOPE, BrownDistortion(k1=-0.2)), board_poses(20))
    noisy = [view + 0.05 * rng.standard_normal(view.shape) for view in exact]
    found = calibrate_camera(noisy, BOARD, width=256, height=256).distortion
    assert found.k1 == pytest.approx(-0.2, abs=0.02)
    assert (found.k2, found.p1, found.p2) == (0.0, 0.0, 0.0)


def test_too_few_views_are_refused():
    with pytest.raises(InvalidValueError, match="number of views is 4; allowed: at least 5"):
        calibrate_camera(corners_in(camera(SCOPE), board_poses(4)), BOARD, width=256, height=256)


@pytest.mark.parametrize("tilt_deg", [0.0, 3.0])
def test_a_board_that_hardly_tilts_is_refused(tilt_deg):
    rng = np.random.default_rng(0)
    views = corners_in(camera(SCOPE), board_poses(8, tilt_deg=tilt_deg))
    noisy = [view + 0.05 * rng.standard_normal(view.shape) for view in views]
    with pytest.raises(InvalidValueError, match="tilt the board"):
        calibrate_camera(noisy, BOARD, width=256, height=256, coefficients=())


@pytest.mark.parametrize("names", [("k3",), ("p1",)])
def test_coefficients_that_cannot_be_estimated_are_refused(names):
    with pytest.raises(InvalidValueError, match="the pair p1 and p2"):
        calibrate_camera(corners_in(camera(SCOPE), board_poses(5)), BOARD, width=256, height=256, coefficients=names)


def test_views_that_lack_corners_are_refused():
    views = corners_in(camera(SCOPE), board_poses(5))
    views[2] = views[2][:-1]
    with pytest.raises(InvalidValueError, match=r"\(41, 2\); allowed: \(42, 2\)"):
        calibrate_camera(views, BOARD, width=256, height=256)


def test_residual_is_the_angle_and_the_distance():
    turned = SCOPE_FROM_REFERENCE @ pose((0.0, 0.0, 0.02), (0.0, 0.0, 0.0))
    turned[:3, 3] += [0.0003, 0.0, -0.0004]
    assert transform_residual(turned, SCOPE_FROM_REFERENCE) == pytest.approx((0.02, 0.5), rel=1e-6)


def test_projection_with_distortion_inverts_the_pinhole_where_there_is_none():
    points = np.array([[0.01, -0.02, 0.1], [0.0, 0.0, 0.07]])
    np.testing.assert_allclose(camera(SCOPE).project(points), SCOPE.project(points), atol=1e-12)


def test_file_gives_back_what_was_saved(stereo, tmp_path):
    path = tmp_path / "new" / "calibration.json"
    save_calibration(path, stereo)
    loaded = load_calibration(path)
    for one, other in ((stereo.scope, loaded.scope), (stereo.reference, loaded.reference)):
        assert one.intrinsics == other.intrinsics
        assert one.distortion == other.distortion
        assert one.view_errors_px == other.view_errors_px
        np.testing.assert_array_equal(one.camera_from_board, other.camera_from_board)
    np.testing.assert_array_equal(loaded.scope_from_reference, stereo.scope_from_reference)
    assert loaded.view_errors_px == stereo.view_errors_px
    assert [entry.name for entry in path.parent.iterdir()] == ["calibration.json"]


def test_file_says_its_version_units_and_frames(stereo, tmp_path):
    save_calibration(tmp_path / "calibration.json", stereo)
    content = json.loads((tmp_path / "calibration.json").read_text())
    assert content["version"] == 1
    assert content["units"]["length"] == "m"
    assert set(content["cameras"]) == {"scope", "reference"}
    assert np.shape(content["transforms"]["scope_from_reference"]) == (4, 4)


def broken(change):
    def apply(content):
        change(content)
        return json.dumps(content)

    return apply


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: "{", "a JSON file that can be read"),
        (lambda _: "[]", "missing field is 'schema'"),
        (lambda _: "[" * 100_000, "a JSON file that can be read"),
        (lambda _: "9" * 5000, "a JSON file that can be read"),
        (broken(lambda c: c["cameras"]["scope"].update(fx=10**400)), "number is '10{49}'; allowed: a finite JSON number"),
        (lambda c: broken(lambda c: c["cameras"]["scope"].update(fx=0.125))(c).replace("0.125", "1e400"), "number is 'inf'"),
        (broken(lambda c: c["cameras"]["scope"].update(width=10**6)), "width is 1000000; allowed: an integer, 1 to 16384"),
        (broken(lambda c: c["cameras"]["scope"]["distortion"].update(k1=1e4)), "k1 is 10000.0; allowed: -1000 to 1000"),
        (broken(lambda c: c["transforms"]["scope_from_reference"][0].__setitem__(3, 1e6)), "a translation of at most 100 m"),
        (broken(lambda c: c["transforms"]["scope_from_reference"][0].__setitem__(3, "0.1")), "number is '0.1'"),
        (broken(lambda c: c["transforms"]["scope_from_reference"][0].__setitem__(0, True)), "number is 'True'"),
        (broken(lambda c: c["transforms"]["scope_from_reference"][0].__setitem__(0, None)), "number is 'None'"),
        (broken(lambda c: c["cameras"]["scope"].update(camera_from_board=[1.0])), "list is 1.0"),
        (broken(lambda c: c["cameras"]["scope"]["camera_from_board"].pop()), "number of camera_from_board is 7; allowed: 8"),
        (broken(lambda c: c.update(version=2)), "version is 2; allowed: 1"),
        (broken(lambda c: c.update(units={"length": "mm"})), "units is"),
        (broken(lambda c: c["cameras"].pop("reference")), "missing field is 'cameras.reference'"),
        (broken(lambda c: c["cameras"]["scope"].pop("fx")), "missing field is 'fx'"),
        (broken(lambda c: c["cameras"]["scope"].update(fx="wide")), "number is 'wide'"),
        (broken(lambda c: c["cameras"]["scope"].update(fx=-1.0)), "fx is -1.0; allowed: above 0"),
        (broken(lambda c: c["cameras"]["scope"].update(width=256.5)), "a whole number of pixels"),
        (broken(lambda c: c["cameras"]["scope"]["distortion"].pop("k3")), "missing field is 'distortion.k3'"),
        (broken(lambda c: c.update(transforms={"scope_from_reference": [[1.0], [1.0, 2.0]]})), "four rows of four numbers"),
        (broken(lambda c: c.update(transforms={"scope_from_reference": np.diag([2, 1, 1, 1]).tolist()})), "a rigid transform"),
        (broken(lambda c: c.update(view_errors_px=[0.1] * 3)), "number of views is 3; allowed: at least 5"),
        (broken(lambda c: c.update(view_errors_px=[math.nan] * 8)), "NaN is not a number"),
    ],
)
def test_damaged_files_are_refused(stereo, tmp_path, damage, message):
    path = tmp_path / "calibration.json"
    save_calibration(path, stereo)
    path.write_text(damage(json.loads(path.read_text())))
    with pytest.raises(InvalidValueError, match=message):
        load_calibration(path)


@pytest.mark.parametrize("content", [b"", b"\xff\xfe{\x00}\x00", bytes(range(256)), "{}".encode("utf-16")])
def test_files_that_are_not_text_are_refused(tmp_path, content):
    (tmp_path / "calibration.json").write_bytes(content)
    with pytest.raises(InvalidValueError, match="a JSON file that can be read"):
        load_calibration(tmp_path / "calibration.json")


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    with pytest.raises(MissingFileError, match=r"calibration not found at .*nowhere\.json"):
        load_calibration(tmp_path / "nowhere.json")


def test_a_failed_save_leaves_the_older_file_as_it_was(stereo, tmp_path, monkeypatch):
    path = tmp_path / "calibration.json"
    path.write_text("older")

    def fail(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_text", fail)
    with pytest.raises(OutputError, match="No space left"):
        save_calibration(path, stereo)
    assert path.read_text() == "older"
    assert [entry.name for entry in tmp_path.iterdir()] == ["calibration.json"]


def whole_record(stereo):
    projector_from_camera = pose((0.1, 0.2, 0.3), (-0.005, 0.0, 0.0))
    projector = ProjectorCalibration(
        projector_from_camera=projector_from_camera,
        period_tan=0.0577,
        phase_turns=-0.25,
        view_errors_turns=(0.01,) * 5,
        deviations=dict.fromkeys(UNKNOWNS, 1e-6),
    )
    hand_eye = HandEyeCalibration(
        flange_from_camera=pose((0.0, 1.0, 0.0), (-0.0025, 0.0, 0.42)), world_from_board=np.eye(4), view_errors_px=(0.1,) * 5
    )
    return CalibrationRecord(scope=stereo.scope, stereo=stereo, projector=projector, hand_eye=hand_eye)


def test_file_keeps_projector_and_hand_eye_where_there_are_any(stereo, tmp_path):
    path, record = tmp_path / "calibration.json", whole_record(stereo)
    save_calibration(path, stereo)
    assert load_record(path).projector is None
    assert load_record(path).hand_eye is None
    save_calibration(path, stereo, projector=record.projector, hand_eye=record.hand_eye)
    loaded = load_record(path)
    np.testing.assert_array_equal(loaded.projector.projector_from_camera, record.projector.projector_from_camera)
    assert loaded.projector.period_tan == record.projector.period_tan
    assert loaded.projector.phase_turns == record.projector.phase_turns
    assert loaded.projector.view_errors_turns == record.projector.view_errors_turns
    assert loaded.projector.deviations == record.projector.deviations
    np.testing.assert_array_equal(loaded.hand_eye.flange_from_camera, record.hand_eye.flange_from_camera)
    assert loaded.hand_eye.view_errors_px == record.hand_eye.view_errors_px


@pytest.mark.parametrize(
    ("section", "change", "message"),
    [
        ("projector", {"period_tan": 0.0}, "period_tan is 0.0; allowed: above 0"),
        ("projector", {"phase_turns": 0.7}, "-0.5 to 0.5"),
        ("projector", {"deviations": {}}, "missing field is 'deviations.x_m'"),
        ("hand_eye", {"view_errors_px": [0.1]}, "number of views is 1"),
        ("hand_eye", {"flange_from_camera": np.diag([2.0, 1.0, 1.0, 1.0]).tolist()}, "a rigid transform"),
    ],
)
def test_damaged_sections_are_refused(stereo, tmp_path, section, change, message):
    path, record = tmp_path / "calibration.json", whole_record(stereo)
    save_calibration(path, stereo, projector=record.projector, hand_eye=record.hand_eye)
    content = json.loads(path.read_text())
    content[section].update(change)
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidValueError, match=message):
        load_record(path)
