import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.recording.episode_log import EpisodeLog
from laploop.envs.recording.picture_colors import ColorScale
from laploop.envs.recording.recorder import (
    CompositeRecorder,
    DepthRecord,
    FrameRecord,
    NullRecorder,
    PredictionRecord,
    Recorder,
    TickRecord,
)
from laploop.envs.recording.rerun_recorder import DEPTH_UNITS_PER_M, RerunRecorder
from laploop.envs.recording.rerun_scene import VertexNormals
from laploop.errors import OutputError, UnknownNameError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate, DepthFrame, StripeFrame

RIG = Rig.from_optics(ScopeOptics(width=32, height=32))
PERIOD_NS = 40_000_000
SCENE = """
<mujoco>
  <asset><mesh name="link" vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 .1" group="2"/>
    <geom name="wall" type="box" size=".3 .3 .001" pos="0 0 .3" rgba=".9 .7 .6 .3" group="2"/>
    <body name="camera_arm/link" pos="-.3 0 .3">
      <joint axis="0 0 1"/>
      <geom name="camera_arm/link" type="mesh" mesh="link" group="2"/>
      <geom name="camera_arm/shaft" type="cylinder" size=".006 .2" group="2"/>
    </body>
    <body name="tool_arm/tip" pos=".05 0 .1">
      <joint type="slide" axis="0 0 1"/>
      <geom name="tool_arm/shaft" type="capsule" size=".0025 .1" group="1"/>
      <geom name="tool_arm/ball" type="sphere" size=".0015" group="1"/>
      <geom name="tool_arm/hull" type="box" size=".1 .1 .1" group="3"/>
    </body>
    <body name="stage/plate"><geom name="stage/plate" type="box" size=".1 .1 .005" group="1"/></body>
  </worldbody>
</mujoco>
"""


class SmallTheatre:
    """The part of a theatre that a recorder reads, small enough to compile in no time."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(SCENE)
        self.data = mujoco.MjData(self.model)
        self.points = np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03], [0.1, 0.1, 0.03], [0.0, 0.1, 0.03]])
        triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
        self.tissue = SimpleNamespace(surface_points=lambda: self.points, triangles=triangles)
        self.camera_arm = SimpleNamespace(name="camera_arm", trocar_in_world=np.array([0.0, 0.0, 0.3]))
        self.tool_arm = SimpleNamespace(name="tool_arm", trocar_in_world=np.array([0.2, 0.0, 0.3]))
        self.move(0)

    def move(self, index):
        self.points[:, 2] = 0.03 + 0.001 * index
        self.data.qpos[:] = [0.1 * index, -0.001 * index]
        mujoco.mj_forward(self.model, self.data)


def frame_record(index, depth_mm=90.0):
    size = (RIG.camera.height, RIG.camera.width)
    times = {"index": index, "captured_ns": index * PERIOD_NS, "available_ns": index * PERIOD_NS}
    exact = np.full(size, depth_mm, np.float32)
    exact[0] = np.nan
    frame = StripeFrame(image=np.full(size, index, np.uint8), world_from_camera=world_from_camera(), **times)
    return FrameRecord(now_ns=index * PERIOD_NS, frame=frame, exact_depth_mm=exact, object_id=np.ones(size, np.uint8))


def depth_record(index, error_mm=1.0):
    frame = frame_record(index)
    valid = np.isfinite(frame.exact_depth_mm)
    valid[:, 0] = False
    estimate = DepthEstimate(depth_mm=np.nan_to_num(frame.exact_depth_mm) + np.float32(error_mm), valid=valid)
    captured_ns = frame.now_ns
    depth = DepthFrame(
        index=index,
        estimate=estimate,
        captured_ns=captured_ns,
        available_ns=captured_ns + PERIOD_NS,
        world_from_camera=world_from_camera(),
    )
    return DepthRecord(
        now_ns=captured_ns + PERIOD_NS,
        depth=depth,
        stripes=frame.frame.image,
        exact_depth_mm=frame.exact_depth_mm,
        tissue=np.isfinite(frame.exact_depth_mm),
    )


def tick_record(index):
    return TickRecord(
        now_ns=index * 8_000_000,
        target_error_mm=10.0 / (1 + index),
        target_in_world=np.array([0.0, 0.0, 0.03 + 1e-4 * index]),
        rcm_error_mm={"camera": 0.01, "tool": 0.02},
        port_force_n={"camera": 0.02, "tool": 0.04 * index},
        contact_force_n=0.1 * index,
        depth_age_ms=None if index < 10 else 48.0,
        stage_ms={"physics": 2.0, "control": 0.3},
        frame_ms={} if index < 10 else {"transfer": 7.0, "service": 40.0},
        command_mps=np.array([0.001 * index, 0.0, 0.02]),
        tip_velocity_mps=np.array([0.0, 0.0, 0.01]),
        goal_in_world=np.array([0.0, 0.0, 0.0315]),
        off_goal_mm={"along": 2.0, "across": 0.1 * index},
        joint_position_share=np.full(6, 0.5),
        joint_speed_share=0.01 * np.arange(6),
        status="tracking" if index < 7 else "limited",
        status_reason="" if index < 7 else "speed of joint 3",
        reward_terms={"distance": -0.1 * index},
        dropped_frames=index // 5,
    )


def prediction_record(index):
    true = np.array([0.0, 0.0, 0.09])
    return PredictionRecord(
        now_ns=index * 8_000_000,
        predicted_in_camera=true + np.array([0.0, 0.0003, 0.0004]),
        true_in_camera=true,
        predicted_in_world=np.array([0.0, 0.0, 0.03]),
    )


def world_from_camera():
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.12
    return pose


def record_episode(path, frames=4, **options):
    theatre = SmallTheatre()
    with RerunRecorder(path, **options) as recorder:
        recorder.begin(theatre, RIG)
        for index in range(frames):
            theatre.move(index)
            recorder.frame(frame_record(index))
            for number in range(5 * index, 5 * index + 5):
                recorder.prediction(prediction_record(number))
                recorder.tick(tick_record(number))
            if index:
                recorder.depth(depth_record(index - 1))
    return theatre


def chunks_of(path):
    return RrdReader(path).stream().to_chunks()


def column(path, entity, name):
    """Return times in ns and values of one component of an entity, over all chunks, in the order of time."""
    rows = []
    for chunk in chunks_of(path):
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            if name in batch.schema.names:
                times = batch.column("sim_time").cast("int64").to_pylist()
                rows += zip(times, batch.column(name).to_pylist(), strict=True)
    return sorted(rows, key=lambda row: row[0])


def assert_whole(path):
    """Let Rerun's own tool check every message and the footer of a recording."""
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([str(rerun), "rrd", "verify", str(path)], check=True, capture_output=True)  # noqa: S603 - installed with us


def test_every_promised_entity_is_in_the_recording(tmp_path):
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


def test_collision_geoms_and_planes_are_not_drawn(tmp_path):
    record_episode(tmp_path / "episode.rrd")
    entities = {chunk.entity_path for chunk in chunks_of(tmp_path / "episode.rrd")}
    assert not {entity for entity in entities if "hull" in entity or "floor" in entity}


def test_recording_carries_a_blueprint(tmp_path):
    record_episode(tmp_path / "episode.rrd")
    assert len(RrdReader(tmp_path / "episode.rrd").blueprints()) == 1


def test_a_tissue_that_moves_as_a_whole_is_written_once_and_moved_by_its_transform(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=3)
    ((time, vertices),) = column(tmp_path / "episode.rrd", "/world/tissue", "Mesh3D:vertex_positions")
    assert (time, vertices[0][2]) == (0, pytest.approx(0.030, abs=1e-8))  # metres, float32
    offsets = column(tmp_path / "episode.rrd", "/world/tissue", "Transform3D:translation")
    assert [offset[0][2] for _, offset in offsets] == pytest.approx([0.0, 0.001, 0.002], abs=1e-8)


@pytest.mark.parametrize(("detail", "written"), [("default", 2), ("full", 3)])
def test_earlier_frames_keep_the_tissue_they_were_recorded_with(tmp_path, detail, written):
    path, theatre = tmp_path / "episode.rrd", SmallTheatre()
    with RerunRecorder(path, detail=detail) as recorder:
        recorder.begin(theatre, RIG)
        # Two corners rise and two sink: by less than a tenth of a millimetre, then by more.
        for index, bend_m in enumerate((0.0, 0.00005, 0.0005)):
            theatre.points[:, 2] = 0.03 + bend_m * np.array([1.0, -1.0, 1.0, -1.0])
            recorder.frame(frame_record(index))
    heights = [vertices[0][2] for _, vertices in column(path, "/world/tissue", "Mesh3D:vertex_positions")]
    assert heights == pytest.approx([0.03, 0.03005, 0.0305][-written:] if written == 3 else [0.03, 0.0305], abs=1e-8)


def test_everything_has_its_pose_at_time_0_before_the_first_record(tmp_path):
    path, theatre = tmp_path / "episode.rrd", SmallTheatre()
    theatre.move(3)
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, RIG)
    poses = column(path, "/world/tool_arm/tip", "Transform3D:translation")
    assert [(time, pose[0][2]) for time, pose in poses] == [(0, pytest.approx(0.097, abs=1e-8))]
    # A viewer is sent what is static first, so that shapes must not be.
    order = [(chunk.entity_path, chunk.is_static) for chunk in chunks_of(path)]
    assert order.index(("/world/tool_arm/tip", False)) < order.index(("/world/tool_arm/tip/ball", False))


def test_poses_and_ticks_carry_their_simulated_times(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=3)
    poses = column(tmp_path / "episode.rrd", "/world/tool_arm/tip", "Transform3D:translation")
    assert [time for time, _ in poses] == [0, 0, PERIOD_NS, 2 * PERIOD_NS]
    assert [pose[0][2] for _, pose in poses] == pytest.approx([0.100, 0.100, 0.099, 0.098], abs=1e-8)
    force = column(tmp_path / "episode.rrd", "/plots/force_n/force", "Scalars:scalars")
    assert [time for time, _ in force] == [8_000_000 * index for index in range(15)]
    assert [value[0] for _, value in force] == pytest.approx([0.1 * index for index in range(15)])


def test_port_forces_are_recorded_where_there_are_any(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=3)
    forces = column(tmp_path / "episode.rrd", "/plots/port_force_n/tool", "Scalars:scalars")
    assert [value[0] for _, value in forces] == pytest.approx([0.04 * index for index in range(15)])
    with RerunRecorder(tmp_path / "bare.rrd") as recorder:
        recorder.begin(SmallTheatre(), RIG)
        recorder.tick(replace(tick_record(0), port_force_n={}))
    assert not column(tmp_path / "bare.rrd", "/plots/port_force_n/tool", "Scalars:scalars")


def test_age_is_absent_before_the_first_depth_frame(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=3)
    ages = column(tmp_path / "episode.rrd", "/plots/depth_age_ms/age", "Scalars:scalars")
    assert [time for time, _ in ages] == [8_000_000 * index for index in range(10, 15)]


def picture(path, entity):
    """Return the first picture of an entity, as RGB or grey."""
    (_, (blob,)), *_ = column(path, entity, "EncodedImage:blob")
    decoded = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    return decoded[..., ::-1] if decoded.ndim == 3 else decoded


def test_full_detail_keeps_depth_to_its_unit_and_zero_where_there_is_nothing(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=2, detail="full")
    ((time, blobs),) = column(tmp_path / "episode.rrd", "/scope/depth/truth", "EncodedDepthImage:blob")
    stored = cv2.imdecode(np.array(blobs[0], np.uint8), cv2.IMREAD_UNCHANGED)
    assert (time, stored.shape, stored.dtype) == (PERIOD_NS, (32, 32), np.uint16)
    assert not stored[0].any()
    # 90 mm in whole units of 0.01 mm
    assert (stored[1:] / DEPTH_UNITS_PER_M * 1000.0 == 90.0).all()


@pytest.mark.parametrize(("detail", "tolerance"), [("default", 3), ("full", 0)])
def test_stripes_are_those_of_the_frame(tmp_path, detail, tolerance):
    path, theatre = tmp_path / "episode.rrd", SmallTheatre()
    with RerunRecorder(path, detail=detail) as recorder:
        recorder.begin(theatre, RIG)
        recorder.frame(frame_record(77))
    assert np.abs(picture(path, "/scope/image/stripes").astype(int) - 77).max() <= tolerance


def test_an_exact_depth_is_white_in_the_error_and_what_is_unknown_grey(tmp_path):
    path, theatre = tmp_path / "episode.rrd", SmallTheatre()
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, RIG)
        recorder.frame(frame_record(0))
        recorder.depth(depth_record(0, error_mm=0.0))
    error, depth = picture(path, "/scope/image/error"), picture(path, "/scope/image/depth")
    assert (error[1:, 1:] >= 240).all()
    assert (error[0] == 128).all()
    assert (depth[:, 0] == 128).all()


def test_what_is_nearer_than_the_range_has_the_colour_of_its_near_end():
    scale = ColorScale.of_depths(np.full((4, 4), 90.0, np.float32))
    tool, near, far = scale.colors(np.array([20.0, 78.0, 102.0]))
    assert (scale.low_mm, scale.high_mm) == (78.0, 102.0)
    assert (tool == near).all()
    assert near.sum() < far.sum()


def test_errors_are_red_when_too_near_and_blue_when_too_far():
    near, far = ColorScale.of_errors().colors(np.array([-3.0, 3.0])).astype(int)
    assert near[0] > near[2] + 50
    assert far[2] > far[0] + 50


def test_pictures_come_25_times_a_simulated_second_at_most(tmp_path):
    path, theatre = tmp_path / "episode.rrd", SmallTheatre()
    with RerunRecorder(path) as recorder:
        recorder.begin(theatre, RIG)
        for index in range(6):
            record = frame_record(index)
            recorder.frame(replace(record, now_ns=index * 10_000_000))
    stripes = column(path, "/scope/image/stripes", "EncodedImage:blob")
    assert [time for time, _ in stripes] == [0, 40_000_000]


def test_commands_predictions_and_states_are_those_of_the_ticks(tmp_path):
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


def test_surface_points_lie_where_the_estimate_says(tmp_path):
    record_episode(tmp_path / "episode.rrd", frames=2)
    ((_, points),) = column(tmp_path / "episode.rrd", "/world/surface", "Points3D:positions")
    # The camera looks down from 120 mm, the estimate is 91 mm everywhere; first row and column are not valid.
    assert len(points) == 31 * 31
    assert np.array(points)[:, 2] == pytest.approx(0.120 - 0.091, abs=1e-7)


def test_nothing_has_the_final_name_before_close(tmp_path):
    path = tmp_path / "episode.rrd"
    recorder = RerunRecorder(path)
    recorder.begin(SmallTheatre(), RIG)
    recorder.frame(frame_record(0))
    assert not path.exists()
    recorder.close()
    recorder.close()
    assert [entry.name for entry in tmp_path.iterdir()] == ["episode.rrd"]


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_an_episode_that_fails_keeps_its_recording_up_to_then_and_says_so(tmp_path, error):
    path = tmp_path / "episode.rrd"

    def episode():
        with RerunRecorder(path) as recorder:
            recorder.begin(SmallTheatre(), RIG)
            recorder.frame(frame_record(0))
            recorder.tick(tick_record(0))
            raise error

    with pytest.raises(error) as raised:
        episode()
    assert raised.value.__notes__ == [f"the recording up to then is kept in {path}"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["episode.rrd"]
    assert_whole(path)
    assert len(column(path, "/plots/force_n/force", "Scalars:scalars")) == 1


def test_an_episode_that_fails_before_it_begins_leaves_nothing_and_an_earlier_recording_alone(tmp_path):
    (tmp_path / "episode.rrd").write_bytes(b"earlier")

    def episode():
        with RerunRecorder(tmp_path / "episode.rrd"):
            raise KeyError

    with pytest.raises(KeyError) as raised:
        episode()
    assert not hasattr(raised.value, "__notes__")
    assert [entry.read_bytes() for entry in tmp_path.iterdir()] == [b"earlier"]


def test_a_recording_that_broke_off_is_refused(tmp_path):
    recorder = RerunRecorder(tmp_path / "episode.rrd")
    recorder.begin(SmallTheatre(), RIG)
    recorder.frame(frame_record(0))
    disconnect = recorder._stream.disconnect

    def cut_off():
        disconnect()
        partial = tmp_path / ".episode.rrd.partial"
        partial.write_bytes(partial.read_bytes()[:-100])

    recorder._stream.disconnect = cut_off
    with pytest.raises(OutputError, match="broke off"):
        recorder.close()
    assert not list(tmp_path.iterdir())


def test_folder_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(OutputError, match="no/such"):
        RerunRecorder(tmp_path / "no/such/episode.rrd")


def test_unknown_detail_is_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="unknown detail of a recording 'ful'; did you mean 'full'"):
        RerunRecorder(tmp_path / "episode.rrd", detail="ful")
    assert not list(tmp_path.iterdir())


def test_record_before_begin_is_a_mistake(tmp_path):
    with pytest.raises(RuntimeError, match="begin"), RerunRecorder(tmp_path / "episode.rrd") as recorder:
        recorder.frame(frame_record(0))


def test_composite_passes_everything_on_in_order():
    calls = []

    class Spy(Recorder):
        def __init__(self, name):
            self.name = name

        def tick(self, record):
            calls.append((self.name, "tick", record))

        def close(self):
            calls.append((self.name, "close"))

    composite = CompositeRecorder([Spy("a"), Spy("b")])
    record = tick_record(0)
    composite.begin(SmallTheatre(), RIG)
    composite.tick(record)
    composite.frame(frame_record(0))
    composite.depth(depth_record(0))
    composite.close()
    assert calls == [("a", "tick", record), ("b", "tick", record), ("a", "close"), ("b", "close")]


def test_null_recorder_takes_everything_and_keeps_nothing():
    recorder = NullRecorder()
    recorder.begin(SmallTheatre(), RIG)
    recorder.frame(frame_record(0))
    recorder.depth(depth_record(0))
    recorder.tick(tick_record(0))
    recorder.close()
    assert not vars(recorder)
    assert not any([recorder.takes_ticks, recorder.takes_frames, recorder.takes_depth])
    assert CompositeRecorder([NullRecorder(), EpisodeLog()]).takes_ticks


def test_vertex_normals_of_a_tilted_square_are_those_of_its_plane():
    tilt = 0.3
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, tilt], [0, 1, tilt]], dtype=np.float32)
    normals = VertexNormals(np.array([[0, 1, 2], [0, 2, 3]]), 4)(points)
    expected = np.array([0.0, -tilt, 1.0]) / np.hypot(tilt, 1.0)
    assert normals == pytest.approx(np.tile(expected, (4, 1)), abs=1e-6)  # float32


def test_error_is_nan_where_the_estimate_is_not_valid_or_not_on_tissue():
    error = depth_record(0, error_mm=1.0).error_mm()
    assert np.isnan(error[0]).all()
    assert np.isnan(error[:, 0]).all()
    assert (error[1:, 1:] == 1.0).all()


def test_legend_names_the_colours(tmp_path):
    record_episode(tmp_path / "episode.rrd")
    (chunk,) = [chunk for chunk in chunks_of(tmp_path / "episode.rrd") if chunk.entity_path == "/legend"]
    assert "red -3 mm (too near)" in json.dumps(chunk.to_record_batch().to_pydict(), default=str)
