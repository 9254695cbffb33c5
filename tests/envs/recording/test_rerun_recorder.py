import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from laploop.envs.recording.rerun_recorder import DEPTH_UNITS_PER_M, RerunRecorder

PERIOD_NS = 40_000_000


def test_every_promised_entity_is_in_the_recording(tmp_path, record_episode, chunks_of):
    record_episode(tmp_path / "episode.rrd")
    entities = {chunk.entity_path for chunk in chunks_of(tmp_path / "episode.rrd")}
    assert {
        "/world/camera_arm/link",
        "/world/camera_arm/link/shaft",
        "/world/tool_arm/tip",
        "/world/tool_arm/tip/ball",
        "/world/stage/plate/plate",
        "/world/theatre/wall",
        "/world/trocars/camera_arm",
        "/world/trocars/tool_arm",
        "/world/tissue",
        "/world/surface",
        "/world/camera",
        "/world/target",
        "/scope/image/stripes",
        "/scope/image/depth",
        "/scope/image/truth",
        "/scope/image/error",
        "/plots/target_error_mm/target",
        "/plots/rcm_error_mm/camera",
        "/plots/rcm_error_mm/tool",
        "/plots/port_force_n/camera",
        "/plots/port_force_n/tool",
        "/plots/force_n/force",
        "/plots/depth_age_ms/age",
        "/plots/frame_ms/transfer",
        "/plots/frame_ms/service",
        "/plots/stage_ms/physics",
        "/plots/tip_velocity_mmps/command_z",
        "/plots/tip_velocity_mmps/tip_z",
        "/plots/joint_position_share/joint_6",
        "/plots/joint_speed_share/limit",
        "/plots/prediction_error_mm/distance",
        "/plots/reward/distance",
        "/plots/dropped_frames/count",
        "/states/status",
        "/world/goal",
        "/world/prediction",
        "/scope/image/key_depth",
        "/scope/image/key_error",
    } <= entities


def test_collision_geoms_and_planes_are_not_drawn(tmp_path, record_episode, chunks_of):
    record_episode(tmp_path / "episode.rrd")
    entities = {chunk.entity_path for chunk in chunks_of(tmp_path / "episode.rrd")}
    assert not {entity for entity in entities if "hull" in entity or "floor" in entity}


def test_recording_carries_a_blueprint(tmp_path, record_episode):
    record_episode(tmp_path / "episode.rrd")
    assert len(RrdReader(tmp_path / "episode.rrd").blueprints()) == 1


def test_a_tissue_that_moves_as_a_whole_is_written_once_and_moved_by_its_transform(tmp_path, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=3)
    ((time, vertices),) = column(tmp_path / "episode.rrd", "/world/tissue", "Mesh3D:vertex_positions")
    assert (time, vertices[0][2]) == (0, pytest.approx(0.030, abs=1e-8))  # metres, float32
    offsets = column(tmp_path / "episode.rrd", "/world/tissue", "Transform3D:translation")
    assert [offset[0][2] for _, offset in offsets] == pytest.approx([0.0, 0.001, 0.002], abs=1e-8)


@pytest.mark.parametrize(("detail", "written"), [("default", 2), ("full", 3)])
def test_earlier_frames_keep_the_tissue_they_were_recorded_with(
    tmp_path, detail, written, small_theatre, rig, frame_record, column
):
    path, theatre = tmp_path / "episode.rrd", small_theatre()
    with RerunRecorder(path, detail=detail) as recorder:
        recorder.begin(theatre, rig)
        # Two corners rise and two sink: by less than a tenth of a millimetre, then by more.
        for index, bend_m in enumerate((0.0, 0.00005, 0.0005)):
            theatre.points[:, 2] = 0.03 + bend_m * np.array([1.0, -1.0, 1.0, -1.0])
            recorder.frame(frame_record(index))
    heights = [vertices[0][2] for _, vertices in column(path, "/world/tissue", "Mesh3D:vertex_positions")]
    assert heights == pytest.approx([0.03, 0.03005, 0.0305][-written:] if written == 3 else [0.03, 0.0305], abs=1e-8)


def test_everything_has_its_pose_at_time_0_before_the_first_record(tmp_path, small_theatre, rig, chunks_of, column):
    path, theatre = tmp_path / "episode.rrd", small_theatre()
    theatre.move(3)
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, rig)
    poses = column(path, "/world/tool_arm/tip", "Transform3D:translation")
    assert [(time, pose[0][2]) for time, pose in poses] == [(0, pytest.approx(0.097, abs=1e-8))]
    # A viewer is sent what is static first, so that shapes must not be.
    order = [(chunk.entity_path, chunk.is_static) for chunk in chunks_of(path)]
    assert order.index(("/world/tool_arm/tip", False)) < order.index(("/world/tool_arm/tip/ball", False))


def test_poses_and_ticks_carry_their_simulated_times(tmp_path, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=3)
    poses = column(tmp_path / "episode.rrd", "/world/tool_arm/tip", "Transform3D:translation")
    assert [time for time, _ in poses] == [0, 0, PERIOD_NS, 2 * PERIOD_NS]
    assert [pose[0][2] for _, pose in poses] == pytest.approx([0.100, 0.100, 0.099, 0.098], abs=1e-8)
    force = column(tmp_path / "episode.rrd", "/plots/force_n/force", "Scalars:scalars")
    assert [time for time, _ in force] == [8_000_000 * index for index in range(15)]
    assert [value[0] for _, value in force] == pytest.approx([0.1 * index for index in range(15)])


def test_port_forces_are_recorded_where_there_are_any(tmp_path, small_theatre, rig, tick_record, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=3)
    forces = column(tmp_path / "episode.rrd", "/plots/port_force_n/tool", "Scalars:scalars")
    assert [value[0] for _, value in forces] == pytest.approx([0.04 * index for index in range(15)])
    with RerunRecorder(tmp_path / "bare.rrd") as recorder:
        recorder.begin(small_theatre(), rig)
        recorder.tick(replace(tick_record(0), port_force_n={}))
    assert not column(tmp_path / "bare.rrd", "/plots/port_force_n/tool", "Scalars:scalars")


def test_age_is_absent_before_the_first_depth_frame(tmp_path, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=3)
    ages = column(tmp_path / "episode.rrd", "/plots/depth_age_ms/age", "Scalars:scalars")
    assert [time for time, _ in ages] == [8_000_000 * index for index in range(10, 15)]


def test_full_detail_keeps_depth_to_its_unit_and_zero_where_there_is_nothing(tmp_path, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=2, detail="full")
    ((time, blobs),) = column(tmp_path / "episode.rrd", "/scope/depth/truth", "EncodedDepthImage:blob")
    stored = cv2.imdecode(np.array(blobs[0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert (time, stored.shape, stored.dtype) == (PERIOD_NS, (32, 32), np.uint16)
    assert not stored[0].any()
    # 90 mm in whole units of 0.01 mm
    assert (stored[1:] / DEPTH_UNITS_PER_M * 1000.0 == 90.0).all()


@pytest.mark.parametrize(("detail", "tolerance"), [("default", 3), ("full", 0)])
def test_stripes_are_those_of_the_frame(tmp_path, detail, tolerance, small_theatre, rig, frame_record, picture):
    path, theatre = tmp_path / "episode.rrd", small_theatre()
    with RerunRecorder(path, detail=detail) as recorder:
        recorder.begin(theatre, rig)
        recorder.frame(frame_record(77))
    assert np.abs(picture(path, "/scope/image/stripes").astype(int) - 77).max() <= tolerance


def test_an_exact_depth_is_white_in_the_error_and_what_is_unknown_grey(
    tmp_path, small_theatre, rig, frame_record, depth_record, picture
):
    path, theatre = tmp_path / "episode.rrd", small_theatre()
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, rig)
        recorder.frame(frame_record(0))
        recorder.depth(depth_record(0, error_mm=0.0))
    error, depth = picture(path, "/scope/image/error"), picture(path, "/scope/image/depth")
    assert (error[1:, 1:] >= 240).all()
    assert (error[0] == 128).all()
    assert (depth[:, 0] == 128).all()


def test_pictures_come_25_times_a_simulated_second_at_most(tmp_path, small_theatre, rig, frame_record, column):
    path, theatre = tmp_path / "episode.rrd", small_theatre()
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, rig)
        for index in range(6):
            record = frame_record(index)
            recorder.frame(replace(record, now_ns=index * 10_000_000))
    stripes = column(path, "/scope/image/stripes", "EncodedImage:blob")
    assert [time for time, _ in stripes] == [0, 40_000_000]


def test_commands_predictions_and_states_are_those_of_the_ticks(tmp_path, record_episode, column):
    path = tmp_path / "episode.rrd"
    record_episode(path, frames=3)
    command = column(path, "/plots/tip_velocity_mmps/command_x", "Scalars:scalars")
    assert [value[0] for _, value in command] == pytest.approx([1.0 * index for index in range(15)])
    error = column(path, "/plots/prediction_error_mm/distance", "Scalars:scalars")
    assert [value[0] for _, value in error] == pytest.approx([0.5] * 15)
    states = column(path, "/states/status", "StateChange:state")
    assert [(time, state[0]) for time, state in states] == [(0, "tracking"), (7 * 8_000_000, "limited")]
    reasons = column(path, "/states/reason", "StateChange:state")
    assert [state[0] for _, state in reasons] == ["none", "speed of joint 3"]


def test_surface_points_lie_where_the_estimate_says(tmp_path, record_episode, column):
    record_episode(tmp_path / "episode.rrd", frames=2)
    ((_, points),) = column(tmp_path / "episode.rrd", "/world/surface", "Points3D:positions")
    # The camera looks down from 120 mm, the estimate is 91 mm everywhere; first row and column are not valid.
    assert len(points) == 31 * 31
    assert np.array(points)[:, 2] == pytest.approx(0.120 - 0.091, abs=1e-7)


def test_legend_names_the_colours(tmp_path, record_episode, chunks_of):
    record_episode(tmp_path / "episode.rrd")
    (chunk,) = [chunk for chunk in chunks_of(tmp_path / "episode.rrd") if chunk.entity_path == "/legend"]
    assert "red -3 mm (too near)" in json.dumps(chunk.to_record_batch().to_pydict(), default=str)
