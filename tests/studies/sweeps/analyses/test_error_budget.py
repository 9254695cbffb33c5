import numpy as np
import pytest

from laploop.errors import SimulationError
from laploop.studies.episodes.trials import failed_row
from laploop.studies.sweeps.analyses.error_budget import budget_of
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.analyses.shapley import shapley_values
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.run import run_sweep
from laploop.studies.sweeps.sweep_file import read_sweep

CAUSES = """
[[switches]]
name = "latency"
set = {"loop.timing.pipeline.latency_ms" = 0.0}
[[switches]]
name = "arms"
set = {actuation = "ideal"}
[[switches]]
name = "calibration"
set = {"loop.kinematic_errors.hand_eye_m" = 0.0}
"""


def row(episode):
    """Stand in for an episode: latency and arms each cost something, and together more; calibration adds noise."""
    late = episode.task.loop.timing.pipeline.latency_ms
    slow = episode.actuation_name() != "ideal"
    off = episode.task.loop.kinematic_errors.hand_eye_m
    noise = np.random.default_rng(episode.seed).normal(0.0, 0.2)
    error = 1.0 + 0.02 * late + 0.5 * slow + 0.01 * late * slow + 1e3 * off * (1.0 + noise)
    found = failed_row(episode.seed, SimulationError("none"))
    return {**found, "error": None, "metrics": {"total_rms_mm": error, "force_max_n": None}}


@pytest.fixture
def budget(sweep_file, tmp_path):
    def run(hand_eye_m):
        base = f'settle_s = 0.1\nactuation = "ur5-cb"\nloop.kinematic_errors.hand_eye_m = {hand_eye_m}'
        vary = ('"loop.timing.pipeline.latency_ms" = [0, 50.0]\nprediction = ["none", "rate"]', "")
        latency = ("service = {", 'pipeline = {kind = "constant", latency_ms = 100.0}\nservice = {')
        path = sweep_file(
            ("settle_s = 0.1", base), vary, latency, ("seeds = 2", 'seeds = 8\nanalysis = "error-budget"'), more=CAUSES
        )
        sweep = read_sweep(path)
        return sweep, run_sweep(sweep, tmp_path, Engine(), run=row)

    return run


def test_parts_add_up_and_interactions_are_shared(budget):
    sweep, outcomes = budget(0.001)
    found = budget_of(outcomes, "total_rms_mm")
    causes = {name: one["mean"] for name, one in found["causes"].items()}
    assert sum(causes.values()) == pytest.approx(found["real"]["mean"] - found["ideal"]["mean"], rel=1e-12)
    assert causes["latency"] == pytest.approx(2.0 + 0.5)
    assert causes["arms"] == pytest.approx(0.5 + 0.5)
    assert found["causes"]["calibration"]["low"] < 1.0 < found["causes"]["calibration"]["high"]
    assert budget_of(outcomes, "force_max_n") is None
    findings = analyse(sweep, outcomes)
    (chart,) = findings.charts
    assert chart.series[0].x == ["all ideal", "latency", "arms", "calibration", "all real"] or causes["calibration"] > 1.0
    last = chart.series[0].base[-2] + chart.series[0].y[-2]
    assert last == pytest.approx(chart.series[0].y[-1])
    assert "| total_rms_mm |" in findings.markdown
    (said,) = findings.sentences
    assert said.startswith("RMS error is 1 mm with all causes ideal, ")
    assert "+2.5 mm by latency" in said


def test_a_cause_that_is_off_at_its_source_has_no_part(budget):
    _, outcomes = budget(0.0)
    part = budget_of(outcomes, "total_rms_mm")["causes"]["calibration"]
    assert part["low"] <= 0.0 <= part["high"]
    assert part["mean"] == pytest.approx(0.0, abs=1e-12)


def test_shapley_values_of_a_game_with_a_known_answer():
    """Three gloves, two of them left: only a pair is worth something."""
    worth = shapley_values(["left", "other left", "right"], lambda have: float("right" in have and len(have) > 1))
    assert worth == pytest.approx({"left": 1 / 6, "other left": 1 / 6, "right": 4 / 6})
