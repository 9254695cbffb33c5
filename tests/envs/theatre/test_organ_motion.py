"""Respiration and heartbeat move the stage as their amplitudes and frequencies say."""

import numpy as np
import pytest

from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.errors import InvalidValueError, UnknownNameError

TIMES = np.arange(0.0, 20.0, 0.002)


def path(motion):
    return np.array([motion.displacement(time) for time in TIMES])


def test_still_is_still():
    assert not path(BaseMotion.named("still")).any()


def test_breathing_is_ten_millimetres_peak_to_peak_at_a_quarter_hertz():
    z = path(BaseMotion.named("breathing"))
    # Metres: the peaks lie between samples 2 ms apart.
    np.testing.assert_allclose([z.max(), z.min()], [0.005, -0.005], atol=1e-8)
    spectrum = np.abs(np.fft.rfft(z))
    np.testing.assert_allclose(np.fft.rfftfreq(z.size, 0.002)[spectrum.argmax()], 0.25, atol=1e-9)


def test_beating_is_one_millimetre_peak_to_peak():
    z = path(BaseMotion.named("beating"))
    np.testing.assert_allclose(np.ptp(z), 0.001, rtol=1e-4)


def test_both_is_the_sum():
    both = path(BaseMotion.named("both"))
    np.testing.assert_allclose(both, path(BaseMotion.named("breathing")) + path(BaseMotion.named("beating")), atol=1e-15)


def test_seed_chooses_open_phases_and_leaves_given_ones():
    motion = BaseMotion(breathing_peak_to_peak_m=0.01, beating_phase_rad=0.5)
    drawn = motion.with_phases(np.random.default_rng(1))
    assert drawn.beating_phase_rad == 0.5
    assert drawn.breathing_phase_rad is not None
    assert drawn == motion.with_phases(np.random.default_rng(1))
    assert drawn != motion.with_phases(np.random.default_rng(2))


def test_unknown_motion_lists_the_known_ones():
    with pytest.raises(UnknownNameError, match="beating, both, breathing, still"):
        BaseMotion.named("running")


@pytest.mark.parametrize(
    ("field", "value"),
    [("breathing_peak_to_peak_m", 0.5), ("beating_hz", 0.0), ("breathing_phase_rad", float("nan"))],
)
def test_impossible_motions_are_refused(field, value):
    with pytest.raises(InvalidValueError, match=field):
        BaseMotion(**{field: value})
