"""The tasks behind dm_env's interface."""

import dm_env
import numpy as np
import pytest
from dm_env import specs

from laploop.envs.dm import DmEnvironment, load
from laploop.errors import InvalidValueError, UnknownNameError

STILL = np.zeros(3, np.float32)


def test_specs_describe_actions_and_observations(task_env):
    env = DmEnvironment(task_env("reach", observation_mode="state"), seed=3)
    action = env.action_spec()
    assert isinstance(action, specs.BoundedArray)
    assert (action.shape, action.dtype, float(action.maximum[0])) == ((3,), np.float32, pytest.approx(0.06))
    step = env.reset()
    assert step.first()
    for name, spec in env.observation_spec().items():
        spec.validate(step.observation[name])
    assert env.reward_spec().validate(np.float64(env.step(STILL).reward)).shape == ()


def test_an_episode_that_runs_out_of_time_ends_with_discount_1_and_the_next_step_begins_another(task_env):
    env = DmEnvironment(task_env("reach", observation_mode="state", max_seconds=0.06), seed=3)
    # Without a reset, the first step is one.
    kinds = [env.step(STILL) for _ in range(5)]
    assert [one.step_type for one in kinds[:4]] == [dm_env.StepType.FIRST, *[dm_env.StepType.MID] * 2, dm_env.StepType.LAST]
    assert [one.discount for one in kinds[:4]] == [None, 1.0, 1.0, 1.0]
    assert kinds[4].first()
    assert not np.array_equal(kinds[0].observation["target_pixel"], kinds[4].observation["target_pixel"])


def test_an_episode_that_terminates_ends_with_discount_0(task_env):
    env = DmEnvironment(task_env("reach", observation_mode="state", harm_rcm_m=1e-9), seed=3)
    step = env.reset()
    while not step.last():
        step = env.step(env.action_spec().maximum)
    assert step.discount == 0.0
    assert env.info["terminated_by"] == "rcm"


def test_a_state_goes_on_to_the_same_bits(task_env):
    env, fresh = (DmEnvironment(task_env("reach", observation_mode="state"), seed=seed) for seed in (3, 4))
    env.reset()
    env.step(STILL)
    fresh.set_state(env.get_state())
    for _ in range(3):
        one, other = env.step(STILL), fresh.step(STILL)
        assert one.reward == other.reward
        np.testing.assert_array_equal(one.observation["tip_position"], other.observation["tip_position"])


def test_tasks_are_loaded_by_name_and_other_spaces_refused():
    env = load("reach", perception="oracle")
    assert env.env.task == "reach"
    env.close()
    with pytest.raises(UnknownNameError, match="task"):
        load("reech")
    env.env.action_space = None
    with pytest.raises(InvalidValueError, match="space of action"):
        env.action_spec()
