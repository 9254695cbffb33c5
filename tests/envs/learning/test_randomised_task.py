from dataclasses import replace
from functools import reduce
from operator import getitem

import gymnasium as gym
import numpy as np
import pytest

from laploop.configuration import to_plain
from laploop.envs.learning.options import KEYWORD_PATHS, LearnerOptions, applied
from laploop.envs.learning.reach import ReachLearnerEnv
from laploop.envs.randomisation.files import randomisation_of
from laploop.envs.randomisation.randomisation import with_values
from laploop.envs.tasks.registry import default_config
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.errors import InvalidValueError, UnknownNameError

YOUNG = "loop.theatre.tissue.material.young_pa"
SOFTNESS = {YOUNG: {"uniform": [3000, 12000]}}


def steps(env, seed, count=12):
    """Reset and push sideways; return everything that the environment tells."""
    observed, info = env.reset(seed=seed)
    told = [(observed, 0.0, info["contact_force_n"], info["target_error_mm"])]
    for number in range(count):
        observed, reward, _, _, after = env.step(np.array([0.2, 0.1, 1.0 if number < 8 else -1.0], np.float32))
        told.append((observed, reward, after["contact_force_n"], after["target_error_mm"]))
    return told, info


@pytest.mark.parametrize("observation", ["state", "stripes"])
def test_an_episode_is_to_the_bit_the_one_with_the_recorded_values_set_by_hand(learner, observation):
    env = learner(randomisation="wide", observation=observation)
    nominal = env.task_env.config
    env.reset(seed=1)
    told, info = steps(env, seed=4)
    assert len(info["randomisation"]) > 30
    config = with_values(nominal, info["randomisation"])
    assert config == env.task_env.config
    by_hand = ReachLearnerEnv(config=config, perception="oracle", observation=observation)
    try:
        again, plain = steps(by_hand, seed=4)
    finally:
        by_hand.close()
    assert plain["randomisation"] == {}
    for one, other in zip(told, again, strict=True):
        if observation == "stripes":
            np.testing.assert_array_equal(one[0]["stripes"], other[0]["stripes"])
            np.testing.assert_array_equal(one[0]["proprioception"], other[0]["proprioception"])
        else:
            np.testing.assert_array_equal(one[0], other[0])
        assert one[1:] == other[1:]


def test_the_seed_decides_what_is_drawn_and_further_resets_draw_anew(learner):
    env = learner(randomisation=SOFTNESS)
    drawn = [env.reset(seed=seed)[1]["randomisation"][YOUNG] for seed in (3, None, None, 3, None)]
    assert drawn[0] == drawn[3]
    assert drawn[1] == drawn[4]
    assert len(set(drawn)) == 3
    assert env.task_env.config.loop.theatre.tissue.material.young_pa == drawn[4]


def test_a_curriculum_widens_from_the_nominal_task(learner):
    env = learner(randomisation=SOFTNESS)
    nominal = env.task_env.config
    env.set_randomisation(width=0.0)
    assert env.reset(seed=3)[1]["randomisation"] == {}
    assert env.task_env.config == nominal
    distances = []
    for width in (0.5, 1.0):
        env.set_randomisation(width=width)
        distances.append(env.reset(seed=3)[1]["randomisation"][YOUNG] - 10_000.0)
    assert distances[0] == pytest.approx(0.5 * distances[1])
    env.set_randomisation("none")
    env.reset(seed=3)
    assert env.task_env.config == nominal


def test_environments_of_a_vector_draw_their_own():
    envs = gym.make_vec(
        "laploop/Reach-v1", 2, vectorization_mode="sync", randomisation=SOFTNESS, fidelity="fast", perception="oracle"
    )
    try:
        _, infos = envs.reset(seed=[3, 4])
        values = infos["randomisation"][YOUNG]
        assert values.shape == (2,)
        assert values[0] != values[1]
        envs.call("set_randomisation", width=0.0)
        _, infos = envs.reset(seed=[3, 4])
        assert YOUNG not in infos["randomisation"]
    finally:
        envs.close()


def test_bad_randomisations_are_refused_when_the_environment_is_made(learner):
    with pytest.raises(UnknownNameError, match="did you mean 'wide'"):
        learner(randomisation="wid")
    with pytest.raises(UnknownNameError, match=f"did you mean '{YOUNG}'"):
        learner(randomisation={"theatre.tissue.young_pa": {"uniform": [1, 2]}})
    with pytest.raises(InvalidValueError, match="allowed: 100 to"):
        learner(randomisation={YOUNG: {"uniform": [1, 2]}})
    with pytest.raises(UnknownNameError, match="randomisation"):
        learner(randomization="wide")


def test_bad_changes_leave_the_randomisation_as_it_was(learner):
    env = learner(randomisation=SOFTNESS)
    for width in (-0.1, 1.1, float("nan"), True, "wide"):
        with pytest.raises(InvalidValueError, match="width"):
            env.set_randomisation(width=width)
    with pytest.raises(UnknownNameError):
        env.set_randomisation("wid", width=0.5)
    before = env.reset(seed=3)[1]["randomisation"]
    env.set_randomisation(width=1.0)
    assert env.reset(seed=3)[1]["randomisation"] == before


@pytest.mark.parametrize(
    ("keywords", "randomisation", "words"),
    [
        ({"latency_ms": 150}, "narrow", r"latency_ms is 150.*draws loop.timing.service.latency_ms; leave latency_ms out"),
        ({"latency_ms": 40.0}, {"loop.timing.service": {"choice": [{}]}}, "draws loop.timing.service; leave"),
        ({"motion": "still"}, "wide", "motion is 'still'; .* draws loop.theatre.motion.breathing_peak_to_peak_m"),
        ({"fidelity": "fast"}, {"loop.physics_hz": {"choice": [250.0, 500.0]}}, "fidelity is 'fast'; .* draws loop.physics_hz"),
    ],
)
def test_a_keyword_that_would_be_drawn_over_is_refused_then_and_later(keywords, randomisation, words):
    with pytest.raises(InvalidValueError, match=words):
        gym.make("laploop/Track-v1", randomisation=randomisation, **keywords)
    env = gym.make("laploop/Track-v1", randomisation=SOFTNESS, **keywords).unwrapped
    try:
        with pytest.raises(InvalidValueError, match=words):
            env.set_randomisation(randomisation, width=0.5)
        assert env.reset(seed=3)[1]["randomisation"].keys() == SOFTNESS.keys()
    finally:
        env.close()


def test_keywords_that_nothing_is_drawn_over_hold_and_those_that_are_none_set_nothing():
    paths = randomisation_of("narrow").plain
    del paths["loop.timing.service.latency_ms"]
    keywords = {"latency_ms": 150, "motion": "breathing", "fidelity": "fast", "perception": "oracle"}
    env = gym.make("laploop/Track-v1", randomisation=paths, **keywords).unwrapped
    try:
        env.reset(seed=4)
        loop = env.task_env.config.loop
        assert (loop.timing.service.latency_ms, loop.physics_hz) == (150.0, 250.0)
        assert loop.theatre.motion == BaseMotion.named("breathing")
    finally:
        env.close()
    gym.make("laploop/Track-v1", randomisation="wide", latency_ms=None, motion=None).close()


@pytest.mark.parametrize(("keyword", "value"), [("motion", "both"), ("latency_ms", 15.0), ("fidelity", "fast")])
def test_what_a_keyword_sets_is_known(keyword, value):
    config = replace(default_config("reach"), observation_mode="state")
    changed = applied(LearnerOptions(**{keyword: value}), config, strict=False)
    values = {path: reduce(getitem, path.split("."), to_plain(changed)) for path in KEYWORD_PATHS[keyword]}
    assert changed == with_values(config, values) != config


def test_a_randomised_scope_needs_an_estimator_by_name(learner):
    class Estimator:
        def estimate(self, image):
            raise NotImplementedError

    scope = {"loop.theatre.scope.baseline_m": {"uniform": [0.004, 0.005]}}
    learner(randomisation=SOFTNESS, perception=Estimator())
    with pytest.raises(InvalidValueError, match="name of an estimator"):
        learner(randomisation=scope, perception=Estimator())


def test_values_that_do_not_go_together_are_refused_at_the_reset(learner):
    least, most = (f"loop.theatre.tissue.shape.lobe_width_{end}_m" for end in ("min", "max"))
    randomisation = randomisation_of({least: {"uniform": [0.026, 0.034]}, most: {"uniform": [0.027, 0.036]}})
    env = learner(randomisation=randomisation)
    drawn = ((seed, randomisation.draw(env.task_env.config, seed)) for seed in range(100))
    seed = next(seed for seed, values in drawn if values[least] > values[most])
    with pytest.raises(InvalidValueError, match=f"randomisation of seed {seed}: .*smallest <= largest"):
        env.reset(seed=seed)
