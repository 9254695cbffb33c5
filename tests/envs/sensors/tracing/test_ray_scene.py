import os
import subprocess
import sys

from laploop.envs.sensors.tracing import ray_scene


def test_a_machine_without_gpu_is_not_warned_about():
    code = "from laploop.envs.sensors.tracing.ray_scene import open_device; open_device('cpu')"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stderr == ""


def test_other_lines_of_warps_library_are_passed_on(capfd):
    with ray_scene._without_driver_warning():
        os.write(2, b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver. GPU execution\n")
        os.write(2, b"Warp CUDA error: Failed to get driver entry point\n")
    assert capfd.readouterr().err == "Warp CUDA error: Failed to get driver entry point\n"
