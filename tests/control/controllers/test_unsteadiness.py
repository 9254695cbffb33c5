import math

import numpy as np
import pytest

from laploop.control.controllers.unsteadiness import Unsteadiness

FRAME_NS = 40_000_000


def watched(speed_at, seconds=4.0, time_constant_s=1.5):
    """Return what is known after control ticks of 8 ms, in which the velocity changes at every fifth."""
    unsteadiness = Unsteadiness(time_constant_s)
    for tick in range(round(seconds / 0.008)):
        frame = tick // 5
        unsteadiness.add(np.array([0.0, 0.0, speed_at(frame * 0.04)]), frame * FRAME_NS)
    return unsteadiness.rms_mps


def test_tissue_at_constant_speed_is_steady():
    assert watched(lambda _: 0.01) == 0.0


def test_a_sine_of_speed_has_the_root_mean_square_of_its_changes():
    hertz, amplitude = 1.25, 0.004
    found = watched(lambda t: amplitude * math.sin(2.0 * math.pi * hertz * t))
    # Changes over 40 ms: 2 A sin(omega 20 ms) cos(...).
    expected = math.sqrt(2.0) * amplitude * math.sin(math.pi * hertz * 0.04)
    assert found == pytest.approx(expected, rel=0.15)


def test_the_first_changes_of_a_filter_that_has_just_started_do_not_count():
    assert watched(lambda t: 0.02 if t > 0.1 else 0.0) == 0.0


def test_one_noisy_frame_hardly_counts_and_is_forgotten():
    def speed_at(time_s):
        # 2 mm/s up and down again.
        return 0.002 if 0.98 < time_s < 1.02 else 0.0

    assert watched(speed_at, seconds=1.12) == pytest.approx(0.002 * math.sqrt(2.0 * 0.04 / 1.5), rel=0.1)
    # Four seconds later: the mean square falls by a factor of exp(4 / 1.5).
    assert watched(speed_at, seconds=5.12) == pytest.approx(0.002 * math.sqrt(2.0 * 0.04 / 1.5 * math.exp(-4.0 / 1.5)), rel=0.1)
