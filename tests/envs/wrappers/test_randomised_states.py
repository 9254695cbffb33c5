"""States of episodes that differ in their configuration, through Gymnasium's wrappers and laploop's."""

import copy
import pickle

import numpy as np
import pytest

from laploop.envs import get_state, set_state
from laploop.envs.wrappers.action_history import ActionHistory
from laploop.envs.wrappers.age_aware_frame_stack import AgeAwareFrameStack
from laploop.envs.wrappers.delay_randomization import DelayRandomization
from laploop.errors import InvalidValueError

SOFTNESS = {"loop.theatre.tissue.material.young_pa": {"uniform": [3000.0, 12000.0]}}


def run(env, count=4):
    """Return everything that some steps give."""
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    return [env.step(action)[:4] for action in actions]


def wrapped(env):
    """Wrap an environment of depth in most that fits it."""
    env = DelayRandomization(env, (10.0, 60.0))
    return ActionHistory(AgeAwareFrameStack(env, 3), 4)


@pytest.mark.parametrize("wrap", [lambda env: env, wrapped])
@pytest.mark.parametrize("randomisation", ["wide", SOFTNESS])
def test_a_state_goes_on_to_the_same_bits_in_another_episode_and_in_a_fresh_environment(randomised, wrap, randomisation):
    env, fresh = (wrap(randomised("depth", randomisation=randomisation)) for _ in range(2))
    env.reset(seed=4)
    run(env, 2)
    state, copied = get_state(env), copy.deepcopy(env)
    expected = run(env)
    env.reset(seed=5)
    for other in (env, fresh):
        set_state(other, pickle.loads(pickle.dumps(state)))  # noqa: S301  our own bytes
        np.testing.assert_equal(run(other), expected)
    np.testing.assert_equal(run(copied), expected)
    copied.close()


def test_the_methods_of_wrappers_set_states_of_other_episodes_too(randomised):
    env = ActionHistory(randomised(randomisation=SOFTNESS), 3)
    nominal = env.get_state()
    env.reset(seed=4)
    state, softness = env.get_state(), env.unwrapped.task_env.config
    expected = run(env)
    env.reset(seed=5)
    env.set_state(state)
    assert env.unwrapped.task_env.config == softness
    np.testing.assert_equal(run(env), expected)
    env.set_state(nominal)  # Taken before the first reset.
    assert env.unwrapped.task_env.config != softness


def test_a_state_that_is_refused_leaves_the_episode_as_it_was(randomised):
    env, other = (ActionHistory(randomised(randomisation=SOFTNESS), k) for k in (3, 4))
    track = ActionHistory(randomised(task="track", randomisation=SOFTNESS), 3)
    for each in (env, other, track):
        each.reset(seed=4)
    task = env.unwrapped.task_env
    for state in (other.get_state(), track.get_state()):
        with pytest.raises(InvalidValueError, match=r"(in|of) the state"):
            env.set_state(state)
    assert env.unwrapped.task_env is task
    run(env)
