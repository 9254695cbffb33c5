import copy
import pickle

import numpy as np
import pytest

from laploop.errors import InvalidValueError


@pytest.fixture
def actions():
    return np.random.default_rng(0).uniform(-1.0, 1.0, (4, 3)).astype(np.float32)


def run(env, actions):
    return [env.step(action)[:3] for action in actions]


def assert_same(found, wanted):
    for (seen, *rest), (expected, *others) in zip(found, wanted, strict=True):
        assert rest == others
        np.testing.assert_equal(seen, expected)


@pytest.mark.parametrize("observation", ["state", "depth+state"])
def test_a_state_a_copy_and_a_pickle_go_on_to_the_same_bits(learner, actions, observation):
    env = learner(observation=observation, render_mode="rgb_array", render_view="scope")
    env.reset(seed=4)
    env.step(actions[0])
    env.render()  # A picture is no part of a state.
    state, twin, pickled = env.get_state(), copy.deepcopy(env), pickle.dumps(env)
    wanted = run(env, actions)
    assert_same(run(twin, actions), wanted)
    other = pickle.loads(pickled)  # noqa: S301  our own
    assert_same(run(other, actions), wanted)
    env.set_state(state)
    assert_same(run(env, actions), wanted)
    assert env.render().dtype == np.uint8
    for copied in (twin, other):
        copied.close()


def test_a_state_leaves_the_options_of_the_environment_that_takes_it(learner, actions):
    dense, sparse = learner(reward="dense"), learner(reward="sparse")
    dense.reset(seed=4)
    sparse.set_state(dense.get_state())
    assert sparse.options.reward == "sparse"
    assert [step[1] for step in run(sparse, actions)] == [0.0] * len(actions)


def test_a_state_of_another_task_is_refused(learner):
    with pytest.raises(InvalidValueError, match="state"):
        learner("track").set_state(learner("reach").get_state())


def test_a_state_of_a_randomised_episode_brings_its_configuration(learner, actions):
    path = "loop.theatre.tissue.material.young_pa"
    first, other = (learner(randomisation={path: {"uniform": [2000.0, 9000.0]}}) for _ in range(2))
    _, info = first.reset(seed=4)
    other.reset(seed=5)
    state, twin = first.get_state(), copy.deepcopy(first)
    wanted = run(first, actions)
    other.set_state(state)
    assert other.task_env.config == first.task_env.config
    assert_same(run(other, actions), wanted)
    assert_same(run(twin, actions), wanted)
    twin.close()
    assert 2000.0 < info["randomisation"][path] < 9000.0
