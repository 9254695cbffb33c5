import os
import subprocess
import sys
from pathlib import Path

import pytest

LAPLOOP = Path(sys.executable).with_name("laploop")
FULL = "No space left on device"


def shell(command):
    """Run a line of shell in which $LAPLOOP is our command; return its status, output and errors."""
    command = ["/bin/bash", "-c", f"set -o pipefail; {command}"]
    environment = {**os.environ, "LAPLOOP": str(LAPLOOP)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)  # noqa: S603 - our own lines
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_closed_streams_change_nothing(closed):
    status, _, error = shell(f"$LAPLOOP --help {closed}")
    assert (status, error) == (0, "")
    assert shell(f"$LAPLOOP fly {closed}")[0] == 2


def test_a_reader_that_leaves_early_is_no_failure():
    status, out, error = shell("$LAPLOOP --help | head -1")
    assert (status, error) == (0, "")
    assert out.startswith("usage:")


def test_a_full_standard_output_is_one_line_and_a_failure():
    status, _, error = shell("$LAPLOOP --help >/dev/full")
    assert (status, error) == (1, f"laploop: cannot write to the standard output: {FULL}\n")


def test_a_full_standard_error_stream_does_not_change_the_status():
    assert shell("$LAPLOOP --version 2>/dev/full")[0] == 0
    assert shell("$LAPLOOP fly 2>/dev/full")[0] == 2


def test_a_deleted_working_folder_is_one_line(tmp_path):
    status, _, error = shell(f"mkdir {tmp_path}/a && cd {tmp_path}/a && rmdir {tmp_path}/a && $LAPLOOP run --out x")
    assert (status, error) == (2, f"laploop run: working folder not found at {tmp_path}/a; change to one that exists\n")
