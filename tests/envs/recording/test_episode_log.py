import numpy as np
import pytest

from laploop.envs.recording.episode_log import MAX_KEPT, EpisodeLog
from laploop.envs.recording.recorder import DepthRecord, TickRecord
from laploop.perception.messages import DepthEstimate, DepthFrame

PERIOD_NS = 40_000_000


def depth_record(index):
    values = np.zeros((2, 2), np.float32)
    frame = DepthFrame(
        index=index,
        estimate=DepthEstimate(depth_mm=values, valid=np.ones((2, 2), bool)),
        captured_ns=index * PERIOD_NS,
        available_ns=(index + 1) * PERIOD_NS,
        world_from_camera=np.eye(4),
    )
    return DepthRecord(
        now_ns=(index + 1) * PERIOD_NS,
        depth=frame,
        stripes=np.zeros((2, 2), np.uint8),
        exact_depth_mm=values,
        tissue=np.ones((2, 2), bool),
    )


def log_of(count):
    log = EpisodeLog()
    for index in range(count):
        log.depth(depth_record(index))
    return log


@pytest.mark.parametrize("count", [3, 5, 16, 17, 100, 751, 5000])
def test_key_depths_are_the_first_the_middle_and_the_last(count):
    first, middle, last = (record.depth.index for record in log_of(count).key_depths())
    assert (first, last) == (0, count - 1)
    # Records are kept at a stride of at most a seventh of the episode, so the middle is off by at most half of that.
    assert middle == pytest.approx((count - 1) / 2, abs=max(1.0, count / 14))


@pytest.mark.parametrize(("count", "expected"), [(0, []), (1, [0]), (2, [0, 1])])
def test_short_episodes_have_fewer_key_depths(count, expected):
    assert [record.depth.index for record in log_of(count).key_depths()] == expected


def test_memory_is_bounded_however_long_the_episode():
    log = log_of(5000)
    assert len(log._kept) <= MAX_KEPT
    assert log.key_depths()[-1].depth.index == 4999


def test_series_are_arrays_with_nan_where_there_was_nothing():
    log = EpisodeLog()
    for index, age in enumerate([None, 48.0]):
        log.tick(
            TickRecord(
                now_ns=index * 8_000_000,
                target_error_mm=2.0 - index,
                target_in_world=np.zeros(3),
                rcm_error_mm={"camera": 0.1, "tool": 0.2 + index},
                contact_force_n=0.0,
                depth_age_ms=age,
                stage_ms={"physics": 1.0} if index else {},
            )
        )
    assert log.times_s() == pytest.approx([0.0, 0.008])
    assert log.series("target_error_mm").tolist() == [2.0, 1.0]
    assert log.series("rcm_error_mm/tool").tolist() == [0.2, 1.2]
    np.testing.assert_array_equal(log.series("depth_age_ms"), [np.nan, 48.0])
    np.testing.assert_array_equal(log.series("stage_ms/physics"), [np.nan, 1.0])
