import numpy as np
import pytest

from laploop.studies.sweeps.step_response import step_response
from laploop.studies.sweeps.tick_metrics import tick_metrics

TIME_S = np.arange(0.0, 10.0, 0.008)


def metrics(along_mm, across_mm, **given):
    every = {"force_n": np.zeros(TIME_S.size), "age_ms": np.full(TIME_S.size, 40.0), "assessed": TIME_S >= 2.0}
    return tick_metrics(time_s=TIME_S, along_mm=along_mm, across_mm=across_mm, **{**every, **given})


def test_a_sine_has_the_rms_of_a_sine_after_settling():
    along = np.where(TIME_S < 2.0, 50.0, 3.0 * np.sin(2.0 * np.pi * 0.5 * TIME_S))
    found = metrics(along, np.full(TIME_S.size, 1.0))
    assert found["normal_rms_mm"] == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-3)
    assert found["normal_p95_mm"] == pytest.approx(3.0 * np.sin(0.95 * np.pi / 2.0), rel=1e-2)
    assert found["lateral_rms_mm"] == found["lateral_p95_mm"] == 1.0
    assert found["total_rms_mm"] == pytest.approx(np.sqrt(4.5 + 1.0), rel=1e-3)


def test_time_to_target_is_that_of_the_first_tick_within_it():
    found = metrics(10.0 * np.exp(-TIME_S), np.zeros(TIME_S.size))
    assert found["time_to_target_s"] == pytest.approx(np.log(10.0 / 1.5), abs=0.008)
    assert metrics(np.full(TIME_S.size, 2.0), np.zeros(TIME_S.size))["time_to_target_s"] is None


def test_forces_count_in_all_ticks_and_ages_where_there_is_depth():
    age_ms = np.where(TIME_S < 5.0, np.nan, 60.0)
    age_ms[-1] = 500.0
    force_n = np.where(TIME_S < 1.0, 2.0, 0.0)
    found = metrics(np.zeros(TIME_S.size), np.zeros(TIME_S.size), force_n=force_n, age_ms=age_ms)
    assert found["force_mean_n"] == pytest.approx(0.2)
    assert found["force_max_n"] == 2.0
    assert found["depth_age_mean_ms"] == pytest.approx(60.0, abs=1.0)
    assert found["depth_age_p99_ms"] == 60.0


def test_nothing_assessed_is_none():
    found = metrics(np.zeros(TIME_S.size), np.zeros(TIME_S.size), assessed=np.zeros(TIME_S.size, bool))
    assert found["total_rms_mm"] is None
    assert found["time_to_target_s"] == 0.0


@pytest.mark.parametrize("growth", [-0.8, 0.3])
def test_growth_and_overshoot_of_an_oscillation(growth):
    swing = np.exp(growth * TIME_S) * np.cos(2.0 * np.pi * TIME_S)
    found = step_response(TIME_S, 0.004 * np.stack([0.6 * swing, 0.8 * swing], axis=1))
    assert found["growth_per_s"] == pytest.approx(growth, abs=2e-3)
    if growth < 0.0:
        assert found["overshoot_percent"] == pytest.approx(100.0 * np.exp(0.5 * growth), rel=1e-2)


def test_a_loop_that_creeps_has_no_overshoot_and_no_growth():
    found = step_response(TIME_S, np.exp(-TIME_S)[:, None] * [0.003, 0.0])
    assert found == {"overshoot_percent": 0.0, "growth_per_s": None}
