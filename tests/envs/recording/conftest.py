"""What a recorder is given, small enough to make in no time, and how recordings are read back."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import mujoco
import numpy as np
import pytest
from rerun.chunk import RrdReader

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.recording.recorder import (
    DepthRecord,
    FrameRecord,
    PredictionRecord,
    TickRecord,
)
from laploop.envs.recording.rerun_recorder import RerunRecorder
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


def _frame_record(index, depth_mm=90.0):
    size = (RIG.camera.height, RIG.camera.width)
    times = {"index": index, "captured_ns": index * PERIOD_NS, "available_ns": index * PERIOD_NS}
    exact = np.full(size, depth_mm, np.float32)
    exact[0] = np.nan
    frame = StripeFrame(image=np.full(size, index, np.uint8), world_from_camera=world_from_camera(), **times)
    return FrameRecord(now_ns=index * PERIOD_NS, frame=frame, exact_depth_mm=exact, object_id=np.ones(size, np.uint8))


def _depth_record(index, error_mm=1.0):
    frame = _frame_record(index)
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


def _tick_record(index):
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


def _prediction_record(index):
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


def _record_episode(path, frames=4, **options):
    theatre = SmallTheatre()
    with RerunRecorder(path, **options) as recorder:
        recorder.begin(theatre, RIG)
        for index in range(frames):
            theatre.move(index)
            recorder.frame(_frame_record(index))
            for number in range(5 * index, 5 * index + 5):
                recorder.prediction(_prediction_record(number))
                recorder.tick(_tick_record(number))
            if index:
                recorder.depth(_depth_record(index - 1))
    return theatre


def _chunks_of(path):
    return RrdReader(path).stream().to_chunks()


def _column(path, entity, name):
    """Return times in ns and values of one component of an entity, over all chunks, in the order of time."""
    rows = []
    for chunk in _chunks_of(path):
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            if name in batch.schema.names:
                times = batch.column("sim_time").cast("int64").to_pylist()
                rows += zip(times, batch.column(name).to_pylist(), strict=True)
    return sorted(rows, key=lambda row: row[0])


def _assert_whole(path):
    """Let Rerun's own tool check every message and the footer of a recording."""
    rerun = Path(sys.executable).with_name("rerun")
    subprocess.run([str(rerun), "rrd", "verify", str(path)], check=True, capture_output=True)  # noqa: S603 - installed with us


def _picture(path, entity):
    """Return the first picture of an entity, as RGB or grey."""
    (_, (blob,)), *_ = _column(path, entity, "EncodedImage:blob")
    decoded = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    return decoded[..., ::-1] if decoded.ndim == 3 else decoded


@pytest.fixture
def small_theatre():
    return SmallTheatre


@pytest.fixture
def rig():
    return RIG


@pytest.fixture
def frame_record():
    return _frame_record


@pytest.fixture
def depth_record():
    return _depth_record


@pytest.fixture
def tick_record():
    return _tick_record


@pytest.fixture
def prediction_record():
    return _prediction_record


@pytest.fixture
def record_episode():
    return _record_episode


@pytest.fixture
def chunks_of():
    return _chunks_of


@pytest.fixture
def column():
    return _column


@pytest.fixture
def assert_whole():
    return _assert_whole


@pytest.fixture
def picture():
    return _picture
