import numpy as np
import pytest

from laploop.control.prediction.harmonic_model import HarmonicModel
from laploop.errors import InvalidValueError


@pytest.fixture
def model():
    return HarmonicModel((3, 2))


@pytest.fixture
def state(model):
    state = np.random.default_rng(0).normal(size=model.size)
    state[model.rates] = [1.6, 7.5]
    return state


def differences(function, state, step=1e-6):
    columns = [(function(state + step * unit) - function(state - step * unit)) / (2.0 * step) for unit in np.eye(len(state))]
    return np.stack(columns, axis=-1)


def test_value_is_the_written_formula(model, state):
    bias, slow, fast = state[0], state[1:8], state[8:]
    seconds = 0.37
    expected = bias
    for rhythm in (slow, fast):
        for order in range(1, (len(rhythm) - 1) // 2 + 1):
            phasor = complex(rhythm[2 * order - 1], rhythm[2 * order])
            expected += (phasor * np.exp(1j * order * rhythm[0] * seconds)).real
    assert model.look_ahead(state, seconds).value == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("seconds", [-2.0, 0.0, 0.13])
def test_derivatives_are_those_of_finite_differences(model, state, seconds):
    outlook = model.look_ahead(state, seconds)
    # Central differences with steps of 1e-6 on values of order 1.
    np.testing.assert_allclose(outlook.gradient, differences(lambda x: model.look_ahead(x, seconds).value, state), atol=1e-7)
    ahead, behind = (model.look_ahead(state, seconds + step).value for step in (1e-6, -1e-6))
    assert outlook.velocity == pytest.approx((ahead - behind) / 2e-6, abs=1e-6)
    later, transition = model.advance(state, seconds)
    np.testing.assert_allclose(transition, differences(lambda x: model.advance(x, seconds)[0], state), atol=1e-7)
    assert model.look_ahead(later, 0.2).value == pytest.approx(model.look_ahead(state, seconds + 0.2).value, abs=1e-12)


def test_table_agrees_with_single_outlooks(model, state):
    seconds = np.array([-1.0, -0.2, 0.4])
    values, jacobian = model.linearised(state, seconds)
    np.testing.assert_allclose(model.values(state, seconds), values, atol=1e-12)
    for value, row, at in zip(values, jacobian, seconds, strict=True):
        outlook = model.look_ahead(state, at)
        assert value == pytest.approx(outlook.value, abs=1e-12)
        np.testing.assert_allclose(row, outlook.gradient, atol=1e-12)


def test_a_clock_that_runs_ahead_is_the_state_a_moment_later(model, state):
    step = 1e-6
    for rhythm, direction in enumerate(model.phase_directions(state)):
        rates = model.rates[rhythm]
        alone = state.copy()
        others = np.delete(model.rates, rhythm)
        alone[others] = 0.0
        later, _ = model.advance(alone, step / state[rates])
        later[others] = state[others]
        np.testing.assert_allclose(direction, (later - state) / step, atol=1e-5)  # second order of the step


def test_without_rhythms_there_is_only_the_bias():
    model = HarmonicModel(())
    outlook = model.look_ahead(np.array([0.3]), 5.0)
    assert (outlook.value, outlook.velocity, model.size) == (0.3, 0.0, 1)
    later, transition = model.advance(np.array([0.3]), 5.0)
    assert later[0] == 0.3
    assert np.array_equal(transition, np.eye(1))


def test_power_of_a_rhythm_is_that_of_all_its_harmonics(model, state):
    np.testing.assert_allclose(model.powers(state), [np.sum(state[2:8] ** 2), np.sum(state[9:] ** 2)])


def test_rhythm_without_a_harmonic_is_refused():
    with pytest.raises(InvalidValueError, match="harmonics"):
        HarmonicModel((2, 0))
