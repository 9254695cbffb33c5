import math
import threading
import time
from functools import partial

import pytest
import torch

from laploop.envs.environment_state import packed, unpacked
from laploop.envs.loop.background import BackgroundWorker
from laploop.envs.loop.stage_timer import StageTimer
from laploop.errors import SimulationError
from laploop.workers import usable_cores


@pytest.fixture
def timer():
    return StageTimer()


@pytest.fixture
def worker(timer):
    worker = BackgroundWorker("render", timer)
    yield worker
    worker.close()


def test_what_nobody_asks_for_is_not_computed(worker):
    calls = []
    asked, begun, _ = (worker.later(lambda name=name: calls.append(name)) for name in ("asked", "begun", "neither"))
    begun.begin()
    asked.wait()
    assert calls == ["begun", "asked"]
    asked.wait()
    assert calls == ["begun", "asked"]


def test_work_goes_on_in_the_background_in_the_order_in_which_it_is_begun(worker):
    release, order = threading.Event(), []
    first = worker.later(lambda: release.wait(5.0) and order.append((1, threading.current_thread().name)))
    second = worker.later(lambda: order.append((2, threading.current_thread().name)))
    first.begin()
    second.begin()
    assert order == []
    release.set()
    second.wait()
    assert order == [(1, "render_0"), (2, "render_0")]


def test_an_error_surfaces_as_what_it_is(worker):
    failing = worker.later(lambda: {}["missing"])
    for _ in range(2):
        with pytest.raises(KeyError, match="missing"):
            failing.wait()


def test_what_is_needed_from_another_worker_comes_first_and_is_not_this_workers_time(worker, timer):
    release = threading.Event()
    other = BackgroundWorker("perception", timer)
    image = worker.later(lambda: release.wait(5.0))
    depth = other.later(image.result, after=image)
    depth.begin()
    threading.Timer(0.2, release.set).start()
    assert depth.wait()
    other.close()
    milliseconds = timer.lap_ms()
    assert milliseconds["render"] > 150.0
    assert milliseconds["wait"] > 150.0
    assert milliseconds["perception"] < 50.0


def test_a_closed_worker_has_no_thread_and_says_what_was_not_computed(timer):
    before = threading.active_count()
    release = threading.Event()
    worker = BackgroundWorker("render", timer)
    under_way, cancelled, never = (worker.later(lambda: release.wait(5.0)) for _ in range(3))
    under_way.begin()
    cancelled.begin()
    threading.Timer(0.05, release.set).start()
    worker.close()
    assert threading.active_count() <= before + 1  # the timer's own thread may still be ending
    assert under_way.wait()
    for pending in (cancelled, never, never):
        with pytest.raises(SimulationError, match="the episode ended before"):
            pending.wait()


@pytest.mark.parametrize("queued", [False, True])
def test_the_first_job_waits_for_what_an_abandoned_worker_is_at(timer, queued):
    started, release, order = threading.Event(), threading.Event(), []
    old = BackgroundWorker("perception", timer)
    old.later(lambda: (started.set(), release.wait(5.0), order.append("old"))).begin()
    assert started.wait(5.0)
    if queued:
        # Work that will never be done holds nobody up.
        old.later(lambda: order.append("queued")).begin()
    old.abandon()
    new = BackgroundWorker("perception", timer, after=old)
    first = new.later(lambda: order.append("new"))
    first.begin()
    assert order == []
    release.set()
    first.wait()
    assert order == ["old", "new"]
    new.close()


def test_workers_that_begin_nothing_do_not_pile_up(timer):
    started, release = threading.Event(), threading.Event()
    busy = BackgroundWorker("perception", timer)
    assert busy.unfinished() is None
    job = busy.later(lambda: (started.set(), release.wait(5.0))).begin()
    assert started.wait(5.0)
    worker = busy
    for _ in range(3):
        before = worker.unfinished()
        assert before is busy
        worker.abandon()
        worker = BackgroundWorker("perception", timer, after=before)
    release.set()
    worker.later(lambda: None).wait()
    assert job.done()
    worker.settle()
    assert worker.unfinished() is None
    worker.close()


@pytest.mark.parametrize("end", ["close", "settle"])
def test_to_end_a_worker_ends_the_one_before_it(timer, end):
    started, release = threading.Event(), threading.Event()
    old = BackgroundWorker("perception", timer)
    under_way = old.later(lambda: (started.set(), release.wait(5.0))).begin()
    assert started.wait(5.0)
    old.abandon()
    new = BackgroundWorker("perception", timer, after=old)
    threading.Timer(0.05, release.set).start()
    getattr(new, end)()
    assert under_way.done()
    new.close()


def copied(pending, worker):
    """Return a copy, by way of a pickle, that shares the timer, as in the state of an environment."""
    parts = {"timer": worker.timer}
    return unpacked(packed(pending, parts), parts)


def test_a_copy_holds_the_result_of_what_was_begun_and_the_work_of_what_was_not(worker):
    begun, later = worker.later(partial(time.sleep, 0.05)), worker.later(partial(time.sleep, 0.0))
    second = BackgroundWorker("perception", worker.timer)
    after = second.later(partial(math.hypot, 3.0, 4.0), after=later)
    begun.begin()
    one, other = copied(begun, worker), copied(after, worker)
    assert (one.begun, other.begun) == (True, False)
    assert one.wait() is None
    assert other.wait() == 5.0
    assert not after.begun


def test_a_copy_of_what_failed_raises_the_same_error(worker):
    failing, never = worker.later({}.popitem), worker.later(dict)
    failing.begin()
    with pytest.raises(KeyError, match="empty"):
        copied(failing, worker).wait()
    worker.close()
    with pytest.raises(SimulationError, match="the episode ended before"):
        copied(never, worker).wait()


def test_settled_workers_have_nothing_under_way(worker):
    done = []
    worker.settle()
    jobs = [worker.later(lambda number=number: (time.sleep(0.02), done.append(number))) for number in range(3)]
    for job in jobs:
        job.begin()
    worker.settle()
    assert done == [0, 1, 2]


def test_torch_leaves_a_core_to_the_loop(worker):
    everywhere = torch.get_num_threads()
    beside = worker.later(torch.get_num_threads).wait()
    assert beside == min(everywhere, max(1, usable_cores() - 1))
    assert torch.get_num_threads() == everywhere
