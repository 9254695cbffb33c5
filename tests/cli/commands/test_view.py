import os
import signal
import subprocess
import sys
import urllib.request

import psutil
import pytest
import rerun as rr

from laploop.cli.main import main
from laploop.envs.recording import viewer
from laploop.envs.recording.viewer import free_port, is_listening

COMMAND = "import sys; from laploop.cli.main import main; sys.exit(main())"


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_page_of_a_run_is_served_until_a_signal_ends_it(tmp_path, number, status):
    recording = rr.RecordingStream("laploop")
    recording.save(tmp_path / "recording.rrd")
    recording.log("legend", rr.TextDocument("of a run"))
    recording.disconnect()
    port = free_port()
    command = [sys.executable, "-P", "-c", COMMAND, "view", str(tmp_path), "--web", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:  # noqa: S603
        address = process.stdout.readline().strip()
        assert address.startswith(f"http://127.0.0.1:{port}/?url=rerun%2Bhttp://127.0.0.1:")
        with urllib.request.urlopen(address, timeout=20) as page:  # noqa: S310 - our own
            assert b"rerun" in page.read().lower()
        stream_port = int(address.rpartition(":")[2].partition("/")[0])
        assert is_listening(stream_port)
        children = psutil.Process(process.pid).children(recursive=True)
        assert children
        os.kill(process.pid, number)
        assert process.wait(20) == status
    assert not [child for child in children if child.is_running() and child.status() != psutil.STATUS_ZOMBIE]
    assert not is_listening(port)
    assert not is_listening(stream_port)


def test_a_recording_that_is_not_there_is_named_with_what_makes_it(tmp_path, capsys):
    assert main(["view", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"laploop view: recording not found at {tmp_path}/recording.rrd; `laploop run --out DIR` makes one in DIR\n"
    )


def test_without_a_display_the_browser_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(viewer, "has_display", lambda: False)
    (tmp_path / "recording.rrd").touch()
    assert main(["view", str(tmp_path)]) == 1
    assert "there is no display for a window; look at it in the browser with `laploop view --web`" in capsys.readouterr().err
    monkeypatch.setattr(viewer, "is_listening", lambda port: False)
    assert main(["run", "--live", "--seconds", "0.1", "--out", str(tmp_path / "out")]) == 1
    assert "start `laploop view --web` first" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_port_that_is_taken_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(viewer, "is_listening", lambda port: True)
    assert main(["view", "--web", "--port", "9090"]) == 1
    assert "port 9090 is taken" in capsys.readouterr().err
