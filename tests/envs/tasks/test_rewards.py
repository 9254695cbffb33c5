"""The reward terms of every task, worked out again from what its `info` says, as its page describes them."""

import math

import numpy as np
import pytest

from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.tasks.registry import TASKS
from laploop.envs.theatre.theatre import Theatre

PUSH_N = 3.0
"""A force on the tip that is above the alarm of every task."""


def common(env, info, effort):
    harmed = info["terminated_by"] in {"force", "rcm"}
    return {
        "force": -(PUSH_N - env.config.alarm_force_n),
        "effort": -(effort**2),
        "success": float(info["success"]),
        "harm": -float(harmed),
    }


def near(error, scale):
    return -math.tanh(abs(error) / scale)


def terms_of(task, info, before):
    """Return the terms of a task's own, unweighted."""
    error = info["target_error_mm"]
    if task == "reach":
        return {
            "distance": near(error, 20.0),
            "progress": (before["target_error_mm"] - error) / 20.0,
            "contact": float(error < 1.5),
        }
    if task == "track":
        return {"distance": near(error, 20.0), "normal": near(info["normal_error_mm"], 2.0), "contact": -1.0}
    if task == "palpate":
        return {"distance": near(error, 20.0), "band": float(info["in_band"]), "deviation": -1.0 if error <= 5.0 else 0.0}
    if task == "scan":
        scanning = info["assessed"]
        return {
            "distance": near(error, 20.0),
            "progress": 0.0,
            "standoff": near(info["standoff_error_mm"], 2.0) if scanning else 0.0,
            "contact": -1.0,
        }
    return {"centre": near(info["centre_share"], 0.1), "distance": near(info["distance_error_mm"], 10.0)}


@pytest.mark.parametrize("task", TASKS.names())
def test_terms_are_those_of_the_tasks_page_times_their_weights(task_env, monkeypatch, task):
    env = task_env(task)
    _, before = env.reset(seed=3)
    monkeypatch.setattr(Theatre, "contact_force_in_world", lambda _: np.array([0.0, 0.0, PUSH_N]))
    action = np.array([0.01, -0.02, 0.02], np.float32)
    _, reward, *_, info = env.step(action)
    effort = 0.03 / env.config.max_tip_speed_mps
    expected = terms_of(task, info, before) | common(env, info, effort)
    weights = {name: getattr(env.config.rewards, name) for name in expected}
    assert info["reward_terms"] == pytest.approx({name: weights[name] * value for name, value in expected.items()})
    assert reward == pytest.approx(sum(weights[name] * value for name, value in expected.items()))
    # Palpation ends above 2 N, where the others raise their alarm.
    assert info["terminated_by"] == ("force" if task == "palpate" else None)


def test_weights_reward_what_helps_and_punish_what_harms(task_env):
    for task in TASKS.names():
        rewards = task_env(task).config.rewards
        assert all(value > 0.0 for value in vars(rewards).values()), task


@pytest.mark.parametrize(("before_mm", "after_mm", "progress"), [(30.0, 10.0, 1.0), (10.0, 30.0, -1.0), (10.0, 10.0, 0.0)])
def test_coming_nearer_to_the_target_is_progress(task_env, monkeypatch, before_mm, after_mm, progress):
    errors = iter([before_mm, after_mm])
    monkeypatch.setattr(ReachEnv, "target_error_mm", lambda _: next(errors))
    env = task_env("reach")
    env.reset(seed=3)
    *_, info = env.step(np.zeros(3, np.float32))
    terms = info["reward_terms"]
    assert terms["progress"] == pytest.approx(env.config.rewards.progress * progress)
    assert terms["distance"] == pytest.approx(-env.config.rewards.distance * math.tanh(after_mm / 20.0))
