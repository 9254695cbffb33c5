"""Both checkers; every warning is an error, as in all tests."""

import itertools
import json
from pathlib import Path

import gymnasium as gym
import pytest
from gymnasium.utils.env_checker import check_env

import laploop  # noqa: F401  registers the environments
from laploop.envs.learning.registry import LEARNERS
from laploop.envs.tasks.registry import TASKS, default_config, environment_id

OBSERVATIONS = ("state", "depth", "stripes", "depth+state")
FIDELITIES = ("fast", "full")
CHECKED = [(task, OBSERVATIONS[i % 4]) for i, task in enumerate(TASKS.names())]


@pytest.mark.parametrize(("task", "observation"), CHECKED)
def test_gymnasiums_checker_passes_without_a_warning(learner, task, observation):
    check_env(learner(task, observation=observation), skip_render_check=True)


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_stable_baselines_checker_passes_without_a_warning(learner, observation):
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(learner(observation=observation), warn=True)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "observation", "fidelity"), list(itertools.product(TASKS.names(), OBSERVATIONS, FIDELITIES)))
def test_both_checkers_pass_for_every_observation_and_fidelity(task, observation, fidelity):
    stable = pytest.importorskip("stable_baselines3.common.env_checker")
    made = gym.make(environment_id(task, 1), observation=observation, fidelity=fidelity, perception="oracle")
    check_env(made.unwrapped, skip_render_check=True)
    stable.check_env(made, warn=True)
    made.close()


@pytest.mark.parametrize("task", TASKS.names())
def test_gymnasium_knows_length_and_threshold(task):
    spec = gym.spec(environment_id(task, 1))
    assert spec.max_episode_steps == default_config(task).max_seconds / 0.04
    assert spec.reward_threshold == LEARNERS[task].reward_threshold
    returns = json.loads((Path(__file__).parents[3] / "docs" / "results" / "learner-returns.json").read_text())["tasks"][task]
    # 90 % of the scripted controller's, rounded to a tenth; far above doing nothing and chance.
    assert spec.reward_threshold == pytest.approx(0.9 * returns["scripted"]["mean_return"], abs=0.051)
    assert spec.reward_threshold > max(returns["zero"]["mean_return"], returns["random"]["mean_return"]) + 0.5
