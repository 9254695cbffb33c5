import numpy as np
import pytest

from laploop.studies.fidelity import run
from laploop.studies.fidelity.config import FidelityConfig
from laploop.studies.fidelity.run import as_markdown, measure_fidelity


@pytest.fixture(scope="module")
def result():
    return measure_fidelity(FidelityConfig(seeds=1, first_seed=3))


def test_the_same_commands_press_both_nearly_alike(result):
    overall = result["overall"]
    # Newtons and millimetres: half the steps and a quarter of the triangles.
    assert 0.1 < overall["force_full_n"] < 2.0
    assert 0.0 < overall["force_rms_n"] < 0.25
    assert 0.0 < overall["surface_rms_mm"] < 0.3
    assert 0.0 < overall["depth_mae_mm"] < 0.05
    assert {name: one["episodes"] for name, one in result["episodes"].items()} == {"full": 1, "fast": 1}
    text = as_markdown(result)
    assert f"{overall['force_rms_n']:.3f} N" in text


def test_a_theatre_differs_by_nothing_from_itself(monkeypatch):
    monkeypatch.setattr(run, "NAMES", ("full", "full"))
    rows = measure_fidelity(FidelityConfig(seeds=1, first_seed=3))["seeds"]
    assert rows[0]["force_full_n"] == rows[0]["force_fast_n"] > 0.0
    assert not np.any([rows[0][name] for name in ("force_rms_n", "surface_rms_mm", "surface_worst_mm", "depth_mae_mm")])
