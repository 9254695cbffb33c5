from pathlib import Path

import numpy as np
import pytest

from laploop.assets import ScopeOptics
from laploop.errors import MissingFileError
from laploop.perception import Rig
from laploop.studies.readme.sensor_figure import depth_per_turn, draw_sensor, main

RESULTS = Path(__file__).parents[3] / "docs" / "results"


def test_a_turn_of_phase_is_the_depth_that_the_rig_says():
    rig = Rig.from_optics(ScopeOptics())
    step = 1e-6
    depth_m = np.array([0.07, 0.1, 0.14])
    period_tan = 2.0 * np.tan(0.5 * rig.mask.fov_rad) / rig.mask.stripes
    # Where a pixel on the optical axis falls on the mask, x_p = -b / Z, in turns; by a central difference.
    turns_per_m = (-rig.baseline_m / (depth_m + step) + rig.baseline_m / (depth_m - step)) / (2.0 * step * period_tan)
    np.testing.assert_allclose(depth_per_turn(depth_m, rig), 1.0 / turns_per_m, rtol=1e-6)


def test_the_picture_is_drawn_from_the_committed_results(tmp_path):
    main([str(RESULTS), str(tmp_path / "sensor.png")])
    assert (tmp_path / "sensor.png").stat().st_size > 20_000


def test_missing_results_are_named(tmp_path):
    with pytest.raises(MissingFileError, match="characterization"):
        draw_sensor(tmp_path, tmp_path / "sensor.png")
