import pytest

from laploop.envs.loop import stage_timer
from laploop.envs.loop.stage_timer import StageTimer


def test_parts_of_a_stage_make_one_sample():
    timer = StageTimer()
    with timer.measure("control"):
        pass
    with timer.measure("control"):
        pass
    timer.complete("control")
    timer.complete("control")
    assert list(timer.median_ms()) == ["control"]
    assert timer.median_ms() == timer.lap_ms()


def test_a_stage_within_another_is_not_counted_twice(monkeypatch):
    # Seconds: control begins, wait begins, wait ends, control ends.
    moments = iter([0.0, 1.0, 4.0, 6.0])
    monkeypatch.setattr(stage_timer.time, "perf_counter", lambda: next(moments))
    timer = StageTimer()
    with timer.measure("control"), timer.measure("wait"):
        pass
    assert timer.lap_ms() == {"control": 3000.0, "wait": 3000.0}


def test_the_median_is_over_the_samples_in_milliseconds():
    timer = StageTimer()
    for seconds in (0.001, 0.002, 0.009):
        timer.add("physics", seconds)
    assert timer.median_ms()["physics"] == pytest.approx(2.0)
    assert timer.lap_ms()["physics"] == pytest.approx(12.0)
    assert timer.lap_ms() == {}
