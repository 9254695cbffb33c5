import numpy as np
import pytest

from laploop.envs.learning.options import LearnerOptions
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.demonstrations.config import DemonstrationConfig, Perturbation
from laploop.studies.demonstrations.expert import Disturbance

STILL = np.zeros(3, np.float32)


def disturbance(seed, **config):
    return Disturbance(Perturbation(**config), seed=seed, max_seconds=10.0, decision_s=0.04)


def played(seed, count=250, **config):
    one = disturbance(seed, **config)
    return np.stack([one.disturbed(STILL, number * 0.04) for number in range(count)])


def test_the_same_seed_disturbs_in_the_same_way_and_another_one_does_not():
    np.testing.assert_array_equal(played(3), played(3))
    assert (played(3) != played(4)).any()


def test_without_noise_and_pushes_the_experts_action_is_done_to_the_bit():
    one = disturbance(3, noise=0.0, pushes=0)
    action = np.array([0.1, -0.7, 1.0], np.float32)
    assert one.disturbed(action, 0.0).tobytes() == action.tobytes()


def test_episodes_draw_their_noise_from_none_to_the_largest():
    drawn = [disturbance(seed, noise=0.2).noise for seed in range(200)]
    assert 0.0 <= min(drawn) < 0.01
    assert 0.19 < max(drawn) <= 0.2
    values = played(5, count=20_000, noise=0.2, pushes=0)
    noise = disturbance(5, noise=0.2).noise
    assert values.std() == pytest.approx(noise, rel=0.1)
    # It keeps its value for about the time constant: 0.2 s are 5 decisions, which leave exp(-1) of the correlation.
    later = np.mean(values[5:] * values[:-5]) / np.mean(values**2)
    assert later == pytest.approx(np.exp(-1.0), abs=0.1)


def test_pushes_begin_early_lead_away_from_the_tissue_and_take_the_experts_place():
    pushes = [push for seed in range(100) for push in disturbance(seed, pushes=3).pushes]
    assert 100 < len(pushes) < 200
    assert max(push.begin_s for push in pushes) <= 4.0
    assert all(push.action[2] <= 0.0 for push in pushes)
    assert {round(float(np.linalg.norm(push.action)), 6) for push in pushes} == {0.6}
    seed = next(seed for seed in range(100) if len(disturbance(seed, pushes=1, noise=0.0).pushes) == 1)
    (push,) = disturbance(seed, pushes=1).pushes
    values = played(seed, pushes=1, noise=0.0)
    pushed = np.flatnonzero(values.any(axis=1)) * 0.04
    assert push.begin_s <= pushed[0] < push.begin_s + 0.04
    assert len(pushed) * 0.04 == pytest.approx(0.3, abs=0.041)
    np.testing.assert_allclose(values[values.any(axis=1)], np.tile(push.action, (len(pushed), 1)), rtol=1e-6)


def test_actions_stay_within_their_bounds():
    one = disturbance(3, noise=1.0)
    values = np.stack([one.disturbed(np.ones(3, np.float32), number * 0.04) for number in range(100)])
    assert np.abs(values).max() <= 1.0
    assert values.dtype == np.float32


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"task": "rech"}, UnknownNameError, "did you mean 'reach'"),
        ({"task": "mine:SPEC"}, InvalidValueError, "name of a registered task"),
        ({"task": "reach", "environment": LearnerOptions(action="residual")}, InvalidValueError, "what the expert commands"),
        ({"task": "reach", "perception": "compakt"}, UnknownNameError, "did you mean 'compact'"),
        (
            {
                "task": "reach",
                "environment": LearnerOptions(motion="still"),
                "randomisation": {"loop.theatre.motion.breathing_hz": {"uniform": [0.2, 0.3]}},
            },
            InvalidValueError,
            "leave motion out",
        ),
        ({"task": "reach", "randomisation": {"a": {"unifrom": [1, 2]}}}, UnknownNameError, "did you mean 'uniform'"),
    ],
)
def test_what_cannot_be_demonstrated_is_refused(given, error, words):
    with pytest.raises(error, match=words):
        DemonstrationConfig(**given)


def test_keywords_hold_what_differs_from_the_defaults():
    config = DemonstrationConfig(task="reach", environment=LearnerOptions(observation="depth", latency_ms=20.0))
    assert config.keywords == {"observation": "depth", "latency_ms": 20.0}
    young = {"loop.theatre.tissue.material.young_pa": {"uniform": [3000, 4000]}}
    assert DemonstrationConfig(task="reach", perception="oracle", randomisation=young).keywords == {
        "perception": "oracle",
        "randomisation": young,
    }
    assert DemonstrationConfig(task="reach").key != config.key
