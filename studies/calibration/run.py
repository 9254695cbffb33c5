"""Calibrates the bench from rendered pictures, as a real one is calibrated from photographs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from laploop.assets.calibration_board import blank_card
from laploop.envs.sensors.reference.camera import ReferenceCamera
from laploop.perception.calibration.hand_eye import HandEyeCalibration, calibrate_hand_eye
from laploop.perception.calibration.joint import JointCalibration, calibrate_jointly
from laploop.perception.calibration.projector import CalibratedRig, ProjectorCalibration, calibrate_projector, calibrated_rig
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.calibration.solve import calibrate_camera
from laploop.perception.geometry import invert_transform
from laploop.studies.calibration.config import CalibrationConfig
from laploop.studies.calibration.hand_eye_views import take_hand_eye_views
from laploop.studies.calibration.views import BoardStand, View, between, depth_slices, draw_pose, in_view, is_lit, take_views

Array = NDArray[np.float64]
Progress = Callable[[float], None]

_FACTORY_DEPTHS_M = (0.45, 0.75)
_OWN_TILT_DEG = 35.0
_PAIR_TILT_DEG = 30.0
_CARD_MM = 100.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BenchCalibration:
    """The result of a calibration."""

    config: CalibrationConfig
    joint: JointCalibration
    projector: ProjectorCalibration | None
    rig: CalibratedRig | None
    """The calibrated rig for estimators; None without `projector`."""
    hand_eye: HandEyeCalibration | None

    @property
    def stereo(self) -> StereoCalibration:
        """Both cameras and the transform between them."""
        return self.joint.stereo


def calibrate_bench(config: CalibrationConfig, progress: Progress | None = None) -> BenchCalibration:
    """Take all pictures and calibrate; `progress` is called with the number of views taken, up to `config.pictures`.

    The scope's intrinsics come from its own close and tilted views together with the pairs, in one adjustment with the
    transform; the reference camera's from its own large board, as its maker's would, and stay fixed in it. A pose whose board
    is not found in a picture is replaced by another.

    Raises:
        InfeasibleError: If the board is too large for a picture or never found.
    """
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done)

    # A generator for each step, so that none depends on which others are done.
    own_rng, factory_rng, pair_rng, card_rng, arm_rng = np.random.default_rng(config.seed).spawn(5)
    bench, board = config.bench, config.board
    own = take_own_views(config, own_rng, count)
    scope = calibrate_camera([view.corners[0] for view in own], board, width=bench.scope.width, height=bench.scope.height)
    reference_camera = bench.reference_camera()
    reference = _factory_calibration(config, reference_camera, factory_rng, count)
    pairs = take_pairs(config, reference_camera, pair_rng, count)
    joint = calibrate_jointly(
        [view.corners[0] for view in own],
        [view.corners[0] for view in pairs],
        [view.corners[1] for view in pairs],
        board,
        scope=scope,
        reference=reference,
    )
    calibrated = joint.stereo.scope
    projector = _projector(config, pairs, joint, card_rng, count) if config.projector else None
    hand_eye = None
    if config.hand_eye:
        views = take_hand_eye_views(
            bench,
            board,
            config.views,
            arm_rng,
            depths_m=config.own_depths_m,
            joint_noise_rad=config.joint_noise_rad,
            progress=count,
        )
        hand_eye = calibrate_hand_eye(views.world_from_flange, views.corners, board, calibrated)
    return BenchCalibration(
        config=config,
        joint=joint,
        projector=projector,
        rig=None if projector is None else calibrated_rig(calibrated, projector, bench.rig),
        hand_eye=hand_eye,
    )


def take_own_views(config: CalibrationConfig, rng: np.random.Generator, count: Callable[[], None]) -> list[View]:
    """Take the scope's own pictures of the board, close and tilted, in even light; poses are in its camera's frame."""
    camera, board = config.bench.scope_camera(clear_mask=True), config.board
    stand = BoardStand(board.surface(), [camera])

    def picture(pose: Array) -> Sequence[NDArray[np.uint8]]:
        stand.place(pose)
        return [camera.capture(None, np.eye(4), rng).image]

    def draw(depths_m: tuple[float, float]) -> Array:
        lit = partial(is_lit, board=board, rig=camera.rig)
        return draw_pose(rng, board, camera.rig.camera, depths_m=depths_m, tilt_deg=_OWN_TILT_DEG, seen=lit)

    return list(take_views(draw, picture, board, depth_slices(config.own_depths_m, config.views), count))


def take_pairs(
    config: CalibrationConfig, reference: ReferenceCamera, rng: np.random.Generator, count: Callable[[], None]
) -> list[View]:
    """Take pictures of the board with both cameras of the bench; corners of the scope come first, poses are in its frame."""
    bench, board = config.bench, config.board
    scope, mount, reference_mount = bench.scope_camera(clear_mask=True), bench.world_from_scope, bench.world_from_reference
    reference_from_scope = invert_transform(bench.scope_from_reference)
    stand = BoardStand(board.surface(), [scope, reference])

    def picture(pose: Array) -> Sequence[NDArray[np.uint8]]:
        stand.place(mount @ pose)
        return [scope.capture(None, mount, rng).image, reference.capture(None, reference_mount, rng).rgba]

    def seen(pose: Array) -> bool:
        return is_lit(pose, board, scope.rig) and in_view(reference_from_scope @ pose, board, reference.intrinsics)

    def draw(depths_m: tuple[float, float]) -> Array:
        base = between(bench.scope_from_reference)
        return draw_pose(rng, board, scope.rig.camera, depths_m=depths_m, tilt_deg=_PAIR_TILT_DEG, base=base, seen=seen)

    return list(take_views(draw, picture, board, depth_slices(config.pair_depths_m, config.views), count))


def _factory_calibration(
    config: CalibrationConfig, camera: ReferenceCamera, rng: np.random.Generator, count: Callable[[], None]
) -> CameraCalibration:
    """Calibrate the reference camera with a large board, as its maker does before it is sold."""
    board, k = config.factory_board, camera.intrinsics
    stand = BoardStand(board.surface(), [camera])

    def picture(pose: Array) -> Sequence[NDArray[np.uint8]]:
        stand.place(pose)
        return [camera.capture(None, np.eye(4), rng).rgba]

    def draw(depths_m: tuple[float, float]) -> Array:
        return draw_pose(rng, board, k, depths_m=depths_m, tilt_deg=_OWN_TILT_DEG)

    views = take_views(draw, picture, board, depth_slices(_FACTORY_DEPTHS_M, config.views), count)
    return calibrate_camera([view.corners[0] for view in views], board, width=k.width, height=k.height)


def _projector(
    config: CalibrationConfig,
    pairs: Sequence[View],
    joint: JointCalibration,
    rng: np.random.Generator,
    count: Callable[[], None],
) -> ProjectorCalibration:
    """Lay a blank card on the board in the poses of the pairs and take the stripes on it."""
    camera, board = config.bench.scope_camera(), config.board
    stand = BoardStand(blank_card(_CARD_MM, _CARD_MM), [camera])
    board_from_card = np.eye(4)
    board_from_card[:3, 3] = board.centre
    images = []
    for pair in pairs:
        stand.place(pair.pose @ board_from_card)
        images.append(camera.capture(None, np.eye(4), rng).image)
        count()
    poses = joint.scope_from_board @ board_from_card
    half = 0.5e-3 * _CARD_MM
    return calibrate_projector(images, list(poses), (half, half), joint.stereo.scope, config.bench.rig)
