import pytest

from laploop.envs.loop.timing.log import FRAME_STAGES, FrameTimes, TimingLog


def test_the_age_of_a_frame_at_its_first_use_is_the_sum_of_its_stages():
    times = FrameTimes(
        index=3,
        captured_ns=120_000_000,
        arrived_ns=125_000_000,
        started_ns=125_500_000,
        finished_ns=165_500_000,
        available_ns=166_500_000,
        first_used_ns=168_000_000,
    )
    durations = times.durations_ms()
    assert tuple(durations) == FRAME_STAGES
    assert list(durations.values()) == pytest.approx([5.0, 0.5, 40.0, 1.0, 1.5])
    assert sum(durations.values()) == pytest.approx(48.0)


def test_stages_that_a_frame_has_not_left_have_no_duration():
    times = FrameTimes(index=0, captured_ns=0, arrived_ns=2_000_000, started_ns=2_000_000)
    assert times.durations_ms() == {"transfer": 2.0, "queue": 0.0}


def test_a_frame_that_a_fault_withheld_and_lets_go_is_not_dropped():
    log, times = TimingLog(), FrameTimes(index=0, captured_ns=0)
    log.drop(times, "withheld")
    assert (log.dropped["withheld"], log.dropped_frames) == (1, 0)
    log.deliver(times, 90)
    assert (log.dropped["withheld"], times.dropped, times.available_ns) == (0, None, 90)
    log.drop(times, "overtaken")
    assert log.dropped_frames == 1


def test_a_frame_is_first_used_once():
    log, older, newer = TimingLog(), FrameTimes(index=0, captured_ns=0), FrameTimes(index=1, captured_ns=40)
    assert log.newest_ms() == {}
    for times, now_ns in ((older, 48), (older, 56), (newer, 96)):
        log.use(times, now_ns)
    assert (older.first_used_ns, newer.first_used_ns, log.newest_used) == (48, 96, newer)
