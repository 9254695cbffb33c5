import math
from dataclasses import replace

import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import SimulationError
from laploop.studies.episodes.trials import failed_row
from laploop.studies.sweeps.analyses.findings import analyse
from laploop.studies.sweeps.analyses.pattern import farthest_unambiguous_mm
from laploop.studies.sweeps.engine import Engine
from laploop.studies.sweeps.run import run_sweep
from laploop.studies.sweeps.sweep_file import read_sweep


@pytest.mark.parametrize(("stripes", "farthest_mm"), [(20, 195.3), (40, 91.8), (10, math.inf)])
def test_more_stripes_leave_less_depth_unambiguous(stripes, farthest_mm):
    assert farthest_unambiguous_mm(ScopeOptics(mask=StripeMask(stripes=stripes))) == pytest.approx(farthest_mm, abs=0.1)


def test_a_longer_baseline_does_too():
    far = [farthest_unambiguous_mm(ScopeOptics(baseline_m=length)) for length in (0.004, 0.005, 0.006)]
    assert far == sorted(far, reverse=True)


def row(episode):
    scope, light = episode.task.loop.theatre.scope, episode.task.loop.optics.led_power_w
    found = failed_row(episode.seed, SimulationError("none"))
    return {**found, "error": None, "depth_mae_mm": 1.0 / scope.mask.stripes / light, "depth_valid_fraction": 0.9}


def test_parts_that_change_geometry_tell_the_range(tmp_path):
    sweep = replace(read_sweep("pattern"), seeds=1)
    findings = analyse(sweep, run_sweep(sweep, tmp_path, Engine(), run=row))
    names = [chart.name for chart in findings.charts]
    assert names.count("stripes-unambiguous") == names.count("baseline-unambiguous") == 1
    assert "light-unambiguous" not in names
    assert {"light-depth_mae_mm", "duty-depth_valid_fraction"} <= set(names)
    assert len(findings.results["unambiguous"]) == 10
    assert "| stripes: stripes=40 | 60 | 92 |" in findings.markdown
    assert "Best stripes: `stripes=20`, error 1.61 mm, 90 % valid." in findings.sentences
    assert "Ambiguous beyond 92 mm: `stripes=40`, error 0.806 mm, 90 % valid." in findings.sentences
