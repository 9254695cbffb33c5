import os
import re
import subprocess
import sys

import pytest

from laploop.envs.sensors.tracing import device
from laploop.envs.sensors.tracing.device import open_device
from laploop.errors import OutputError, UnknownNameError


def test_a_machine_without_gpu_is_not_warned_about():
    code = "from laploop.envs.sensors.tracing.device import open_device; open_device('cpu')"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr == ""


def test_other_lines_of_warps_library_are_passed_on(capfd):
    with device._without_driver_warning():
        os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. GPU execution\n")
        os.write(2, b"Warp CUDA error: Failed to get driver entry point\n")
    assert capfd.readouterr().err == "Warp CUDA error: Failed to get driver entry point\n"


def test_unknown_device_is_refused_with_those_that_exist():
    with pytest.raises(UnknownNameError, match=r"unknown device 'tpu'; .*available: cpu"):
        open_device("tpu")


@pytest.mark.parametrize("closed", ["", " 2>&-"])
def test_cache_that_cannot_be_written_is_one_line_that_says_what_to_set(tmp_path, closed):
    (tmp_path / "file").write_text("")
    code = (
        "from laploop.envs.sensors.tracing.device import open_device\n"
        "from laploop.errors import OutputError\n"
        "try:\n    open_device('cpu')\nexcept OutputError as error:\n    print(error)"
    )
    command = f'"$0" -P -c "$1"{closed}'
    done = subprocess.run(  # noqa: S603
        ["/bin/sh", "-c", command, sys.executable, code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "WARP_CACHE_PATH": str(tmp_path / "file" / "cache")},
    )
    (line,) = done.stdout.splitlines()
    assert re.fullmatch(r"cannot keep compiled kernels in \S+: Not a directory; set WARP_CACHE_PATH to a folder .*", line)


def test_kernels_that_cannot_be_kept_are_reported_in_one_line(monkeypatch):
    def full_disk(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(device.wp, "load_module", full_disk)
    with pytest.raises(OutputError, match=r"No space left on device; set WARP_CACHE_PATH"):
        open_device("cpu")
