from dataclasses import replace

import pytest

from laploop.errors import SimulationError
from laploop.studies.episodes.trials import failed_row
from laploop.studies.sweeps.analyses.delay_margin import GAIN, frame_delay, gain_delay
from laploop.studies.sweeps.analyses.delay_theory import border_gain_per_s, overshoot_percent
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.run import run_sweep
from laploop.studies.sweeps.sweep_file import read_sweep


@pytest.fixture(scope="module")
def shipped():
    return read_sweep("delay-margin")


def only(sweep, part, seeds=1):
    return replace(sweep, conditions=tuple(one for one in sweep.conditions if part in one.group), seeds=seeds)


def as_in_theory(episode):
    """Stand in for an episode: growth is in proportion to how far the gain is beyond the border."""
    delay_s, period_s = frame_delay(episode)
    gain = episode.controller.arguments["gain_per_s"]
    growth = 0.3 * (gain - border_gain_per_s(round(delay_s / period_s), period_s))
    metrics = {"growth_per_s": growth, "overshoot_percent": overshoot_percent(gain_delay(episode)), "total_rms_mm": 1.0}
    return {**failed_row(episode.seed, SimulationError("none")), "error": None, "metrics": metrics}


def test_borders_and_overshoots_are_told_beside_theory(shipped, tmp_path):
    outcomes = run_sweep(replace(shipped, seeds=1), tmp_path, Engine(), run=lambda one: as_in_theory(with_gain(one)))
    findings = analyse(replace(shipped, seeds=1), outcomes)
    assert [round(one["delay_frames"], 9) for one in findings.results["borders"]] == [1.0, 2.0, 3.0]
    assert [one["ratio"] for one in findings.results["borders"]] == pytest.approx([1.0] * 3)
    assert [round(one["gain_delay"], 9) for one in findings.results["overshoots"]] == [0.2, 0.5, 0.7, 1.0]
    assert [chart.name for chart in findings.charts][:2] == ["border-1-frame-late", "border-2-frames-late"]
    assert "| 0.7 | 20.6 | 20.6 |" in findings.markdown
    border, overshoot, *_ = findings.sentences
    assert border.startswith(
        "Frames 1, 2 and 3 periods late, the servo becomes unstable at a gain of 25.0, 15.5 and 11.1 per second"
    )
    assert overshoot == "Overshoot is within 0.0 points of theory at every product of gain and delay."


def with_gain(episode):
    """Give episodes of other controllers a gain for the stand-in."""
    arguments = {"gain_per_s": 4.0, **episode.controller.arguments}
    return replace(episode, controller=replace(episode.controller, arguments=arguments))


@pytest.mark.slow  # fifteen episodes of 3 s
def test_the_simulated_border_is_within_three_percent_of_theory(shipped, tmp_path):
    sweep = only(shipped, "border", seeds=2)
    for border in analyse(sweep, run_sweep(sweep, tmp_path, Engine())).results["borders"]:
        assert border["ratio"] == pytest.approx(1.0, abs=0.03)


@pytest.mark.slow  # eight episodes of 3 s
def test_the_simulated_overshoot_is_within_two_points_of_theory(shipped, tmp_path):
    sweep = only(shipped, "overshoot", seeds=2)
    outcomes = run_sweep(sweep, tmp_path, Engine())
    assert [one.condition.values[GAIN] for one in outcomes] == [1.0, 2.5, 3.5, 5.0]
    for outcome, percent in zip(outcomes, [0.0, 4.1, 20.6, 50.0], strict=True):
        assert outcome.values("overshoot_percent") == pytest.approx([percent] * 2, abs=2.0)
