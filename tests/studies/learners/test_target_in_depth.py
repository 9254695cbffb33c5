import gymnasium as gym
import numpy as np
import pytest

from laploop.errors import InvalidValueError
from laploop.studies.learners.target_in_depth import TargetInDepth


@pytest.fixture(scope="module")
def env():
    made = TargetInDepth(
        gym.make("laploop/Track-v1", observation="depth", perception="oracle", fidelity="fast", latency_ms=0.0)
    )
    yield made
    made.close()


def seen(env, observation):
    """Return way (m), normal, and speed (m/s) of the last seven numbers."""
    return observation[-7:-4] * 0.02, observation[-4:-1], observation[-1] * 0.06


def test_the_target_is_where_the_simulator_has_it(env):
    observation, _ = env.reset(seed=5)
    assert env.observation_space.contains(observation)
    for _ in range(25):
        observation, *_, info = env.step(np.zeros(3, np.float32))
    way, normal, _ = seen(env, observation)
    assert observation.size == env.unwrapped.layout.size + 7
    # A level of depth is 0.47 mm; in a second the tissue goes up to 10 mm.
    assert np.linalg.norm(way - env.unwrapped.to_target()) < 0.001
    assert normal @ info["privileged"][3:6] > 0.95


def test_the_speed_is_that_of_the_tissue(env):
    env.reset(seed=6)
    errors, speeds = [], []
    for _ in range(40):
        *_, info = step = env.step(np.zeros(3, np.float32))
        # What moved between two frames, at their middle, against the newest 8 ms.
        speeds.append(info["privileged"][8] * 0.06)
        errors.append(seen(env, step[0])[2] - speeds[-1])
    assert np.sqrt(np.mean(np.square(errors[1:]))) < 0.5 * np.sqrt(np.mean(np.square(speeds[1:])))


def test_other_observations_are_refused():
    with pytest.raises(InvalidValueError, match="observation"):
        TargetInDepth(gym.make("laploop/Track-v1", observation="state"))


def test_the_speed_is_that_of_the_tissue_where_frames_are_lost():
    # Perception takes four frames' time, and looks at every fourth frame.
    env = TargetInDepth(
        gym.make("laploop/Track-v1", observation="depth", perception="oracle", fidelity="fast", latency_ms=150.0)
    )
    env.reset(seed=6)
    told, speeds = [], []
    for _ in range(60):
        observation, *_, info = env.step(np.zeros(3, np.float32))
        told.append(seen(env, observation)[2])
        speeds.append(info["privileged"][8] * 0.06)
    env.close()
    # What it tells is late by up to 330 ms, and no faster than tissue goes; how far the first two maps are apart is not known.
    assert 0.5 * np.abs(speeds).max() < np.abs(told[8:]).max() < 1.2 * np.abs(speeds).max()
