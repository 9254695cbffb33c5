import signal
import subprocess
import time
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.recording import viewer
from laploop.envs.recording.rerun_recorder import RerunRecorder
from laploop.envs.recording.viewer import free_port, is_listening, recording_in
from laploop.errors import MissingFileError
from laploop.perception.geometry import Rig


def record(path, live):
    """Record the begin of an episode in an empty world."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    points = np.array([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03], [0.1, 0.1, 0.03]])
    arm = SimpleNamespace(name="arm", trocar_in_world=np.zeros(3))
    tissue = SimpleNamespace(surface_points=lambda: points, triangles=np.array([[0, 1, 2]]))
    theatre = SimpleNamespace(model=model, data=mujoco.MjData(model), tissue=tissue, camera_arm=arm, tool_arm=arm)
    with RerunRecorder(path, live=live) as recorder:
        recorder.begin(theatre, Rig.from_optics(ScopeOptics(width=32, height=32)))


def test_a_run_is_named_by_its_folder_or_its_recording(tmp_path):
    with pytest.raises(MissingFileError, match="recording not found at"):
        recording_in(tmp_path)
    (tmp_path / "recording.rrd").touch()
    assert recording_in(tmp_path) == recording_in(tmp_path / "recording.rrd") == tmp_path / "recording.rrd"


def test_a_live_run_reaches_a_viewer_that_listens(tmp_path):
    """The server keeps what was streamed to it; asked for it, it writes it to a file."""
    saved, port = tmp_path / "streamed.rrd", free_port()
    command = [str(viewer._program()), "--save", str(saved), "--bind", "127.0.0.1", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:  # noqa: S603
        deadline = time.monotonic() + 20.0
        while not is_listening(port) and time.monotonic() < deadline:
            time.sleep(0.05)
        record(tmp_path / "kept.rrd", viewer.live_viewer(port))
        while not (saved.is_file() and saved.stat().st_size > 10_000) and time.monotonic() < deadline:
            time.sleep(0.1)
        server.send_signal(signal.SIGINT)
        server.wait(20)
    assert (tmp_path / "kept.rrd").stat().st_size > 10_000
    assert saved.stat().st_size > 10_000
