"""Wrappers around environments whose episodes differ: each episode is of another theatre, and may be of another timing."""

import numpy as np
import pytest

from laploop.envs.loop.timing.config import NONE
from laploop.envs.wrappers.action_history import ActionHistory
from laploop.envs.wrappers.age_aware_frame_stack import AgeAwareFrameStack
from laploop.envs.wrappers.conservative_agent import ConservativeAgent
from laploop.envs.wrappers.delay_randomization import DelayRandomization
from laploop.envs.wrappers.goal_conditioned import GoalConditioned

STILL = np.zeros(3, np.float32)
SERVICE = "loop.timing.service.latency_ms"


def told(env, seeds=(4, 5), count=3):
    """Yield what an environment observes and tells, step by step, over an episode a seed."""
    for seed in seeds:
        yield env.reset(seed=seed)
        for _ in range(count):
            observation, *_, info = env.step(STILL)
            yield observation, info


@pytest.mark.parametrize("observation", ["state", "depth"])
def test_the_age_beside_past_actions_is_that_of_the_present_episode(randomised, observation):
    env = ActionHistory(randomised(observation, task="track"), 2)
    for observed, info in told(env):
        age_s = observed["depth_age_s"] if observation == "depth" else observed[-1:]
        assert age_s == pytest.approx(info["depth_age_ms"] * 1e-3)


def test_goals_are_those_of_the_present_episode(randomised):
    for observed, info in told(GoalConditioned(randomised())):
        apart_mm = 1e3 * np.linalg.norm(observed["achieved_goal"] - observed["desired_goal"])
        assert apart_mm == pytest.approx(info["target_error_mm"], abs=1e-4)


def test_frames_are_stacked_with_their_ages_in_every_episode(randomised):
    env = AgeAwareFrameStack(randomised("depth"), 2)
    for seed in (4, 5):
        one, two, *_, last = told(env, (seed,))
        for observed, info in (one, two, last):
            assert observed["depth_ages_s"][-1] == pytest.approx(info["depth_age_ms"] * 1e-3)
        # Nothing is left of the episode before.
        assert one[0]["depth_ages_s"][0] == -1.0
        assert last[0]["depth_ages_s"][0] > last[0]["depth_ages_s"][1]


def test_images_are_held_back_until_they_are_of_age_in_every_episode(randomised):
    env = ConservativeAgent(randomised("stripes"), 120.0)
    for seed in (4, 5):
        first = env.reset(seed=seed)[0]["stripes"]
        shown = [env.step(STILL)[0]["stripes"] for _ in range(5)]
        # The first frame is shown until the second one is of age, 160 ms after the first.
        newer = [bool((image != first).any()) for image in shown]
        assert newer == sorted(newer)
        assert newer[-1]
        assert not newer[0]


def test_a_delay_holds_from_the_reset_on_and_in_place_of_one_that_is_drawn(randomised):
    env = DelayRandomization(randomised("depth"), (70.0, 90.0), stage="service")
    delays = set()
    for seed in (4, 5):
        _, info = env.reset(seed=seed)
        assert info["randomisation"][SERVICE] <= 40.0
        env.step(STILL)
        loop = env.unwrapped.task_env.loop
        assert set(loop.timing_log.service_ns) == {round(1e6 * info["delay_ms"])}
        # What is drawn of the other stages holds.
        assert loop.timing.pipeline.latency_ms == info["randomisation"]["loop.timing.pipeline.latency_ms"] > 0.0
        delays.add(info["delay_ms"])
    assert len(delays) == 2


def test_delays_of_several_stages_hold_together(task_env):
    env = task_env("reach", observation_mode="depth")
    wrapped = DelayRandomization(DelayRandomization(env, (10.0, 20.0)), (50.0, 60.0), stage="service")
    wrapped.reset(seed=3)
    assert 10.0 <= env.loop.timing.transfer.latency_ms <= 20.0
    assert 50.0 <= env.loop.timing.service.latency_ms <= 60.0
    assert env.config.loop.timing.transfer == NONE
