import numpy as np
import pytest

from laploop.control.prediction.alpha_beta import AlphaBetaFilter, AlphaBetaFilterConfig, HeldMeasurement
from laploop.control.prediction.motion_predictor import Prediction
from laploop.control.targeting.tissue_motion import TissueMotion

FRAME_NS = 40_000_000
RATES = np.array([0.004, -0.002, 0.01])


class Oracle:
    """A predictor that knows a displacement of 7 mm, and notes what it learns."""

    def __init__(self, *, trusted):
        self.trusted, self.learnt = trusted, []

    def reset(self):
        self.learnt.clear()

    def update(self, measured, captured_ns):
        self.learnt.append((measured, captured_ns))
        return True

    def predict(self, at_ns):
        return Prediction(value=0.007, velocity=0.05, trusted=self.trusted)


def moving(predictor, frames=40):
    """Return the motion of tissue that goes at a constant rate."""
    motion = TissueMotion(AlphaBetaFilterConfig(), predictor)
    motion.restart(0)
    for k in range(1, frames):
        motion.add(RATES[2] * 0.04 * k, k * FRAME_NS)
        motion.add_across(RATES[:2] * 0.04 * k, k * FRAME_NS)
        motion.work(idle=False)
    return motion


def test_rate_goes_on_along_all_axes_without_a_trusted_prediction():
    now_ns = 39 * FRAME_NS + 60_000_000
    for predictor in (AlphaBetaFilter(), Oracle(trusted=False)):
        motion = moving(predictor).at(now_ns)
        np.testing.assert_allclose(motion.displacement, RATES * now_ns * 1e-9, atol=1e-6)  # metres
        np.testing.assert_allclose(motion.velocity, RATES, atol=1e-5)  # m/s
        assert not motion.predicted


def test_a_trusted_prediction_counts_along_the_optical_axis_alone():
    now_ns = 39 * FRAME_NS
    motion = moving(Oracle(trusted=True)).at(now_ns)
    assert motion.predicted
    np.testing.assert_allclose(motion.displacement, [*RATES[:2] * now_ns * 1e-9, 0.007], atol=1e-6)  # metres
    np.testing.assert_allclose(motion.velocity, [*RATES[:2], 0.05], atol=1e-5)  # m/s


def test_what_a_measurement_should_find_does_not_depend_on_the_predictor():
    found = [moving(Oracle(trusted=trusted)).expected_at(40 * FRAME_NS) for trusted in (True, False)]
    np.testing.assert_array_equal(*found)


def test_a_held_measurement_is_extrapolated_along_no_axis():
    motion = moving(HeldMeasurement()).at(60 * FRAME_NS)
    np.testing.assert_allclose(motion.displacement, RATES * 39 * 0.04, atol=1e-12)
    np.testing.assert_array_equal(motion.velocity, np.zeros(3))


def test_a_frame_that_shows_nothing_reaches_the_predictor_and_changes_nothing_else():
    predictor = Oracle(trusted=False)
    motion = moving(predictor)
    before = motion.expected_at(41 * FRAME_NS)
    motion.add(None, 40 * FRAME_NS)
    motion.work(idle=True)
    assert predictor.learnt[-1] == (None, 40 * FRAME_NS)
    np.testing.assert_array_equal(motion.expected_at(41 * FRAME_NS), before)
    assert motion.measured_ns == 39 * FRAME_NS


def test_restart_forgets():
    predictor = Oracle(trusted=False)
    motion = moving(predictor)
    motion.restart(100 * FRAME_NS)
    np.testing.assert_array_equal(motion.at(101 * FRAME_NS).displacement, np.zeros(3))
    assert predictor.learnt == []
    motion.work(idle=True)
    assert predictor.learnt == [(0.0, 100 * FRAME_NS)]


@pytest.mark.parametrize("trusted", [True, False])
def test_outliers_do_not_move_what_is_measured(trusted):
    motion = moving(Oracle(trusted=trusted))
    before = motion.expected_at(41 * FRAME_NS)
    motion.add(0.05, 40 * FRAME_NS)
    np.testing.assert_array_equal(motion.expected_at(41 * FRAME_NS), before)
