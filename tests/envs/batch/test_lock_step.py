"""Runs in lock step, and the threads that do their calls."""

import threading

import pytest

from laploop.envs.batch.lock_step import run_in_lock_step
from laploop.envs.batch.stepper import ThreadedStepper
from laploop.envs.theatre.physics_call import PhysicsCall, run_alone
from laploop.errors import InvalidValueError


class NotingStepper:
    """Does the calls one after another, and keeps them."""

    def __init__(self):
        self.calls = []

    def do(self, calls, /):
        self.calls.append([call.data for call in calls])
        for call in calls:
            call.do()

    def close(self):
        pass


def run(name, count, done, *, fails=False):
    for number in range(count):
        yield PhysicsCall(lambda model, data: done.append((model, data)), name, number)
    if fails:
        raise ValueError(name)
    return f"{name} of {count}"


def test_a_run_alone_does_each_call_before_it_goes_on():
    done = []
    assert run_alone(run("a", 3, done)) == "a of 3"
    assert done == [("a", 0), ("a", 1), ("a", 2)]


def test_all_wait_for_all_calls_and_shorter_runs_end_earlier():
    done, stepper = [], NotingStepper()
    results, errors = run_in_lock_step({4: run("a", 3, done), 7: run("b", 1, done)}, stepper)
    assert (results, errors) == ({4: "a of 3", 7: "b of 1"}, {})
    assert stepper.calls[:3] == [[0, 0], [1], [2]]


def test_a_run_that_fails_does_not_stop_the_others():
    done = []
    results, errors = run_in_lock_step({0: run("a", 1, done, fails=True), 1: run("b", 3, done)}, NotingStepper())
    assert results == {1: "b of 3"}
    assert (type(errors[0]), str(errors[0])) == (ValueError, "a")


def test_threads_do_calls_at_the_same_time():
    # Each call waits for the other.
    meeting = threading.Barrier(2, timeout=30.0)
    stepper = ThreadedStepper(2)
    names = []

    def meet(_model, data):
        meeting.wait()
        names.append(data)

    stepper.do([PhysicsCall(meet, None, 0), PhysicsCall(meet, None, 1)])
    assert sorted(names) == [0, 1]
    stepper.close()


@pytest.mark.parametrize("threads", [0, 65, 1.0, True, "2"])
def test_a_wrong_number_of_threads_is_refused(threads):
    with pytest.raises(InvalidValueError, match="threads is"):
        ThreadedStepper(threads)
