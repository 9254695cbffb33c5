from dataclasses import replace

import numpy as np
import pytest

from laploop.errors import SimulationError
from laploop.studies.episodes.trials import failed_row
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.analyses.latency import LATENCY, METRIC, follower_gain_per_s, theory
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.run import run_sweep
from laploop.studies.sweeps.sweep_file import read_sweep


@pytest.fixture(scope="module")
def shipped():
    return read_sweep("latency")


def only(sweep, group, **values):
    """Return a sweep of the conditions of a part whose axes, by the ends of their names, have some values."""

    def fits(condition):
        short = {axis.rpartition(".")[2]: value for axis, value in condition.values.items()}
        return condition.group == group and all(short[axis] in chosen for axis, chosen in values.items())

    return replace(sweep, conditions=tuple(one for one in sweep.conditions if fits(one)), seeds=1)


def as_in_theory(episode):
    found = failed_row(episode.seed, SimulationError("none"))
    said = theory(episode)
    error = 0.3 * np.exp(episode.task.loop.timing.pipeline.typical_ns * 4e-9) if said is None else said["following_mm"]
    return {**found, "error": None, "metrics": {METRIC: float(error)}}


def test_theory_knows_gain_delay_and_motion(shipped):
    (condition,) = only(shipped, "latency", latency_ms=[100], prediction=["none"], motion=["breathing"]).conditions
    found = theory(condition.episode)
    assert follower_gain_per_s(condition.episode) == 8.0
    assert found["delay_s"] == pytest.approx(0.1)
    assert found["pure_delay_mm"] == pytest.approx(10.0 * np.sin(np.pi * 0.25 * 0.12) / np.sqrt(2.0))
    assert found["following_mm"] == pytest.approx(1.3327, abs=1e-4)


def test_theory_is_silent_where_it_does_not_apply(shipped):
    assert {theory(one.episode) for one in only(shipped, "latency", prediction=["rate", "rhythms"]).conditions} == {None}
    assert {theory(one.episode) for one in only(shipped, "jitter", sigma=[0.2, 0.8]).conditions} == {None}
    assert {theory(one.episode) for one in only(shipped, "lost frames", drop_rate=[0.1]).conditions} == {None}
    assert {theory(one.episode) for one in only(shipped, "actuation", actuation=["ur5-cb"]).conditions} == {None}


def test_jitter_keeps_the_mean(shipped):
    for condition in only(shipped, "jitter", sigma=[0.2, 0.4, 0.6, 0.8], prediction=["none"]).conditions:
        model = condition.episode.task.loop.timing.pipeline
        assert model.median_ms * np.exp(0.5 * model.sigma**2) == pytest.approx(100.0, rel=1e-5)


def test_charts_carry_theory_and_fits(shipped, tmp_path):
    sweep = only(shipped, "latency", prediction=["none", "rhythms"])
    findings = analyse(sweep, run_sweep(sweep, tmp_path, Engine(), run=as_in_theory))
    assert [chart.name for chart in findings.charts] == ["latency-breathing", "latency-both"]
    names = [line.name for line in findings.charts[0].series]
    assert names == ["rhythms", "none", "theory: delay and gain", "theory: delay alone"]
    measured, said = findings.charts[0].series[1:3]
    assert measured.y == pytest.approx(said.y)
    assert {round(one["ratio"], 9) for one in findings.results["theory"]} == {1.0}
    fit = next(one for one in findings.results["exponential_fits"] if one["series"] == "rhythms")
    assert "Tissue breathing: `rhythms` stays within 1.5 times its error at 0 ms up to 100 ms." in findings.sentences
    assert any(said.startswith("At 630 ms, the delay of Radixact, `rhythms` leaves 3.73 mm") for said in findings.sentences)
    assert "simulation and theory of delay and gain differ by at most 0.0 %" in findings.sentences[-1]
    assert (fit["a_mm"], fit["b_per_s"], fit["r_squared"]) == pytest.approx((0.3, 4.0, 1.0))


def test_jitter_at_the_papers_rate_is_told_beside_a_constant_time(shipped, tmp_path):
    sweep = only(shipped, "26 Hz", prediction=["none"])
    constant, jittery = (one.episode.task.loop.timing.service for one in sweep.conditions)
    assert jittery.median_ms * np.exp(0.5 * jittery.sigma**2) == pytest.approx(constant.latency_ms, rel=1e-5)
    (said,) = analyse(sweep, run_sweep(sweep, tmp_path, Engine(), run=as_in_theory)).sentences
    assert said.startswith("26 Hz, none: with jitter around 38.4 ms in place of 38.4 ms, the RMS error goes from 0.995")


@pytest.mark.slow  # five episodes of 18 s
def test_the_error_of_a_late_follower_is_that_of_theory(shipped, tmp_path):
    latencies = [50, 100, 200, 300, 500]
    sweep = only(shipped, "latency", latency_ms=latencies, prediction=["none"], motion=["breathing"])
    outcomes = run_sweep(sweep, tmp_path, Engine())
    assert [one.condition.values[LATENCY] for one in outcomes] == latencies
    for outcome in outcomes:
        (measured,) = outcome.values(METRIC)
        assert measured == pytest.approx(theory(outcome.condition.episode)["following_mm"], rel=0.05)
        assert outcome.values("force_max_n") == [0.0]
