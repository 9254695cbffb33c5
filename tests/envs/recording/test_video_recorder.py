import math
from types import SimpleNamespace

import cv2
import mujoco
import numpy as np
import pytest

from laploop.assets.operating_table import ABDOMINAL_WALL
from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.recording import video_file
from laploop.envs.recording.recorder import DepthRecord, FrameRecord
from laploop.envs.recording.video_recorder import VideoRecorder
from laploop.envs.sensors.overview_camera import OverviewCamera
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate, DepthFrame, StripeFrame

RIG = Rig.from_optics(ScopeOptics(width=32, height=32))
SCENE = """
<mujoco>
  <worldbody>
    <geom name="{wall}" type="box" size="2 2 .001" pos="0 0 .3" rgba=".9 .7 .6 .3" group="2"/>
    <geom name="stage/plate" type="box" size=".1 .1 .005" group="1"/>
    <body name="tool_arm/tip">
      <joint type="slide" axis="1 0 0"/>
      <geom name="tool_arm/ball" type="sphere" size=".05" pos="0 0 .2" group="1"/>
    </body>
  </worldbody>
</mujoco>
""".replace("{wall}", ABDOMINAL_WALL)


@pytest.fixture
def theatre():
    model = mujoco.MjModel.from_xml_string(SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    points = np.array([[-0.05, -0.05, 0.03], [0.05, -0.05, 0.03], [0.05, 0.05, 0.03], [-0.05, 0.05, 0.03]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    tissue = SimpleNamespace(surface_points=lambda: points, triangles=triangles, rest_points=points)
    return SimpleNamespace(model=model, data=data, tissue=tissue)


def frame(index):
    times = {"index": index, "captured_ns": index * 40_000_000, "available_ns": index * 40_000_000}
    exact = np.full((32, 32), 90.0, np.float32)
    image = StripeFrame(image=np.full((32, 32), 60, np.uint8), world_from_camera=np.eye(4), **times)
    return FrameRecord(now_ns=index * 40_000_000, frame=image, exact_depth_mm=exact, object_id=np.ones((32, 32), np.uint8))


def depth(index, depth_mm):
    record = frame(index)
    estimate = DepthEstimate(depth_mm=np.full((32, 32), depth_mm, np.float32), valid=np.ones((32, 32), bool))
    times = {"captured_ns": record.now_ns, "available_ns": record.now_ns}
    made = DepthFrame(index=index, estimate=estimate, world_from_camera=np.eye(4), **times)
    exact, stripes = record.exact_depth_mm, record.frame.image
    return DepthRecord(now_ns=record.now_ns, depth=made, stripes=stripes, exact_depth_mm=exact, tissue=np.ones((32, 32), bool))


def pictures(path):
    """Return the pictures of a video as RGB."""
    capture, found = cv2.VideoCapture(str(path)), []
    while (read := capture.read())[0]:
        found.append(read[1][..., ::-1])
    return found, capture.get(cv2.CAP_PROP_FPS)


@pytest.mark.parametrize("codec", ["H.264", "MPEG-4"])
def test_a_video_plays_a_picture_a_frame_with_scope_depth_and_theatre_side_by_side(tmp_path, theatre, monkeypatch, codec):
    if codec == "MPEG-4":
        monkeypatch.setattr(video_file, "find_spec", lambda name: None)
    else:
        pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "run.mp4"
    with VideoRecorder(path, camera_hz=25.0) as recorder:
        recorder.begin(theatre, RIG)
        for index in range(5):
            recorder.frame(frame(index))
            # 12 mm around the first frame's 90 mm are the key: 102 mm is its bright end.
            recorder.depth(depth(index, 102.0))
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.mp4"]
    found, fps = pictures(path)
    assert (len(found), fps) == (5, pytest.approx(25.0))
    first, last = found[0].astype(float), found[-1].astype(float)
    assert first.shape == (472, 1152, 3)
    # Nothing has arrived at the first frame: grey. Later, the bright end of viridis: yellow, (253, 231, 37).
    assert first[100:300, 500:700].mean(axis=(0, 1)) == pytest.approx([128, 128, 128], abs=6)
    assert last[100:300, 500:700].mean(axis=(0, 1)) == pytest.approx([253, 231, 37], abs=12)
    # Grey value 60 of a range whose 64 is white.
    assert last[100:300, 100:300].mean() == pytest.approx(60 * 255 / 64, abs=6)


def test_a_recorder_that_never_began_leaves_nothing(tmp_path):
    with VideoRecorder(tmp_path / "run.mp4", camera_hz=25.0):
        pass
    assert not list(tmp_path.iterdir())


def test_paths_that_cannot_be_a_video_are_refused(tmp_path):
    with pytest.raises(InvalidValueError, match=r"the path of an \.mp4 file"):
        VideoRecorder(tmp_path / "run.avi", camera_hz=25.0)
    with pytest.raises(OutputError, match="there is no folder"):
        VideoRecorder(tmp_path / "no" / "run.mp4", camera_hz=25.0)


def test_the_overview_shows_what_moves_and_no_wall(theatre):
    overview = OverviewCamera(width=64, height=64)
    before = overview.picture(theatre)
    column, row = overview.pixel(np.array([0.0, 0.0, 0.2]))
    # The ball, under the wall, is bright, the background nearly black.
    assert before[row, column].max() > 60
    assert before[2, 2].max() < 40
    theatre.data.qpos[0] = 0.3
    mujoco.mj_forward(theatre.model, theatre.data)
    moved = overview.pixel(np.array([0.3, 0.0, 0.2]))
    after = overview.picture(theatre)
    assert after[moved[1], moved[0]].max() > 60
    assert math.dist((column, row), moved) > 5
    overview.close()
