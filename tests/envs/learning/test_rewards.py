import numpy as np
import pytest

from laploop.envs.learning.rewards import approach, closeness, shared_terms

MEASURED = {"force_n": 3.5, "action": np.array([1.0, 0.0, -1.0]), "succeeded": 0.0, "harmed": 0.0}


def test_the_potential_grows_towards_the_goal_and_a_millimetre_counts_more_at_the_end():
    errors = np.array([60.0, 59.0, 2.0, 1.0, 0.0])
    potential = approach(errors)
    assert (np.diff(potential) > 0.0).all()
    assert potential[-1] == 0.0
    # 1 mm is 0.02 far away; near the goal, half of tanh over 5 mm comes on top.
    assert potential[1] - potential[0] == pytest.approx(0.02, abs=1e-4)
    assert potential[3] - potential[2] == pytest.approx(0.02 + 0.5 * (np.tanh(0.4) - np.tanh(0.2)))


def test_closeness_falls_by_e_over_its_scale():
    assert closeness(0.0, 2.0) == 1.0
    assert closeness(-2.0, 2.0) == pytest.approx(np.exp(-1.0))


def test_the_terms_of_all_tasks():
    terms = shared_terms(MEASURED, alarm_n=2.0, harm_n=5.0, fraction=0.004)
    # Half-way from the alarm to harm, and a mean square of 2/3, for one step of 250.
    assert terms["force"] == pytest.approx(-2.0 * 0.5 * 0.004)
    assert terms["speed"] == pytest.approx(-0.1 * 2.0 / 3.0 * 0.004)
    assert terms["success"] == terms["harm"] == 0.0
    ended = shared_terms({**MEASURED, "succeeded": 1.0, "harmed": 1.0}, alarm_n=2.0, harm_n=5.0, fraction=0.004)
    assert (ended["success"], ended["harm"]) == (1.0, -1.0)


def test_the_terms_of_many_environments_are_those_of_each():
    many = {
        "force_n": np.array([3.5, 0.0]),
        "action": np.array([[1.0, 0.0, -1.0], [0.0, 0.0, 0.0]]),
        "succeeded": np.zeros(2),
        "harmed": np.array([0.0, 1.0]),
    }
    terms = shared_terms(many, alarm_n=2.0, harm_n=5.0, fraction=0.004)
    one = shared_terms(MEASURED, alarm_n=2.0, harm_n=5.0, fraction=0.004)
    assert {name: values[0] for name, values in terms.items()} == pytest.approx(one)
    assert terms["harm"][1] == -1.0
    assert terms["force"][1] == 0.0
