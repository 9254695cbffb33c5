import math
import os
import signal
import subprocess
import sys
import time
from functools import partial

import psutil
import pytest

from laploop.errors import InvalidValueError, WorkerError, check_range
from laploop.workers import run_in_workers

JOB_SCRIPT = """
import subprocess, sys, time
from laploop.workers import run_in_workers

def work(seconds):
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    print(child.pid, flush=True)
    time.sleep(seconds)

if __name__ == "__main__":
    run_in_workers(work, [600, 600], 2, print)
"""


LOCK_SCRIPT = """
import multiprocessing
from laploop.workers import run_in_workers

def work(number):
    global lock
    lock = multiprocessing.Lock()

def done(*_):
    raise KeyError

if __name__ == "__main__":
    try:
        run_in_workers(work, [0, 1], 2, done)
    except KeyError:
        pass
"""


def results_of(work, jobs, workers, **options):
    results = {}
    run_in_workers(work, jobs, workers, results.__setitem__, **options)
    return results


@pytest.mark.parametrize("workers", [1, 2])
def test_every_job_gives_its_result(workers):
    assert results_of(math.factorial, [1, 2, 3], workers) == {1: 1, 2: 2, 3: 6}


def test_no_jobs_need_no_workers():
    assert results_of(math.factorial, [], 2) == {}


@pytest.mark.parametrize("workers", [1, 2])
def test_error_of_a_job_is_raised_and_what_was_finished_is_handed_over(workers):
    finished = []
    with pytest.raises(InvalidValueError, match="number is 3"):
        run_in_workers(partial(check_range, "number", low=0, high=2), [1, 3], workers, lambda job, _: finished.append(job))
    # Two workers may find the error first.
    assert finished == [1] or (workers == 2 and finished == [])


def test_workers_are_prepared_and_the_caller_is_called_while_it_waits(tmp_path):
    calls = []
    results = results_of(os.path.abspath, ["a"], 2, prepare=partial(os.chdir, tmp_path), waiting=lambda: calls.append(1))
    assert results == {"a": str(tmp_path / "a")}
    assert calls


def test_worker_that_dies_is_one_clear_error():
    with pytest.raises(WorkerError, match="a worker process died, perhaps for want of memory"):
        results_of(os._exit, [1], 2)


def test_interrupt_ends_busy_workers_at_once():
    def interrupted(_job, _result):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_workers(time.sleep, [0.0, 600.0], 2, interrupted)
    assert not [child for child in psutil.Process().children() if "spawn_main" in " ".join(child.cmdline())]


def test_locks_of_libraries_in_killed_workers_leave_no_warning(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(LOCK_SCRIPT)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)  # noqa: S603 - ours
    assert done.stderr == ""


def test_processes_that_cannot_be_started_are_one_clear_error(monkeypatch):
    def refused(*_arguments, **_options):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr("laploop.workers.ProcessPoolExecutor", refused)
    with pytest.raises(WorkerError, match=r"cannot start worker processes: Read-only file system .*use one worker"):
        results_of(math.factorial, [1], 2)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_nothing_outlives_a_parent_that_is_killed(tmp_path, how):
    script = tmp_path / "script.py"
    script.write_text(JOB_SCRIPT)
    parent = subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True)  # noqa: S603 - our own script
    # Both workers have started a child of their own.
    grandchildren = [psutil.Process(int(parent.stdout.readline())) for _ in range(2)]
    family = [*psutil.Process(parent.pid).children(recursive=True), *grandchildren]
    parent.send_signal(how)
    parent.communicate()
    assert parent.returncode == -how
    assert len(family) >= 5
    # The test's own time limit fails it if one lives on.
    psutil.wait_procs(family)
