import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from sb3_contrib import TQC
from stable_baselines3 import A2C, PPO, SAC

from laploop.errors import InvalidValueError, UnknownNameError, WeightsError
from laploop.studies.learners.curve import CURVE, read_curve
from laploop.studies.learners.curve_callback import CurveCallback
from laploop.studies.learners.policy_file import DESCRIPTION
from laploop.studies.learners.sb3_policy import load_into, load_sb3, save_sb3

NETWORK = {"net_arch": [8]}


class Still(gym.Env):
    """Episodes of four steps; those of even numbers succeed."""

    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def __init__(self, size=3):
        self.observation_space = spaces.Box(-5.0, 5.0, (size,), np.float32)
        self.episode = -1

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count, self.episode = 0, self.episode + 1
        return self.observation_space.sample() * 0.0, {}

    def step(self, action):
        self.count += 1
        done = self.count == 4
        return self.observation_space.sample() * 0.0, 0.5, done, False, {"is_success": done and self.episode % 2 == 0}


@pytest.mark.parametrize("kind", [PPO, SAC, TQC])
def test_a_policy_acts_as_before_it_was_saved(tmp_path, kind):
    model = kind("MlpPolicy", Still(), policy_kwargs=dict(NETWORK), seed=3)
    save_sb3(model, tmp_path, NETWORK)
    policy = load_sb3(tmp_path, Still())
    observation = np.array([0.3, -1.0, 2.0], np.float32)
    before = model.predict(observation, deterministic=True)[0]
    assert np.array_equal(policy.predict(observation, deterministic=True)[0], before)
    assert np.abs(before).max() > 0.0

    other = kind("MlpPolicy", Still(), policy_kwargs=dict(NETWORK), seed=4)
    load_into(other, tmp_path)
    assert np.array_equal(other.predict(observation, deterministic=True)[0], before)


def test_what_does_not_fit_is_refused(tmp_path):
    save_sb3(PPO("MlpPolicy", Still(), policy_kwargs=dict(NETWORK)), tmp_path, NETWORK)
    with pytest.raises(WeightsError, match="does not fit"):
        load_sb3(tmp_path, Still(size=4))
    with pytest.raises(InvalidValueError, match="sac"):
        load_into(SAC("MlpPolicy", Still(), policy_kwargs=dict(NETWORK)), tmp_path)
    (tmp_path / DESCRIPTION).write_text('{"algorithm": "os.system"}')
    with pytest.raises(UnknownNameError, match="algorithm"):
        load_sb3(tmp_path, Still())
    with pytest.raises(InvalidValueError, match="A2C"):
        save_sb3(A2C("MlpPolicy", Still()), tmp_path, {})


def test_a_training_leaves_its_curve_and_its_policy(tmp_path):
    model = PPO("MlpPolicy", Still(), n_steps=16, batch_size=16, policy_kwargs=dict(NETWORK), seed=0)
    model.learn(32, callback=CurveCallback(tmp_path, NETWORK, every=16))
    curve = read_curve(tmp_path)
    assert curve["steps"].tolist() == [4, 8, 12, 16, 20, 24, 28, 32]
    assert curve["success"].tolist() == [1, 0, 1, 0, 1, 0, 1, 0]
    assert curve["total_return"].tolist() == [2.0] * 8
    assert load_sb3(tmp_path, Still()).predict(np.zeros(3, np.float32))[0].shape == (2,)


def test_a_curve_goes_on_where_it_ended(tmp_path):
    for resume in (False, True):
        model = PPO("MlpPolicy", Still(), n_steps=8, batch_size=8, policy_kwargs=dict(NETWORK), seed=0)
        callback = CurveCallback(tmp_path, NETWORK, resume=resume)
        model.learn(8, callback=callback)
    curve = read_curve(tmp_path)
    assert curve["steps"].tolist() == [4, 8, 12, 16]
    assert np.all(np.diff(curve["wall_s"]) >= 0.0)
    assert callback.curve.steps(model.num_timesteps) == 16
    assert callback.curve.cpu_s > curve["cpu_s"][1]


def test_another_table_is_no_curve(tmp_path):
    (tmp_path / CURVE).write_text("a,b\n1,2\n")
    with pytest.raises(InvalidValueError, match="total_return"):
        read_curve(tmp_path)
