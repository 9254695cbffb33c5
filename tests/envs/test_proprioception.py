import numpy as np
import pytest

from laploop.envs.proprioception import Proprioception, ProprioceptionConfig
from laploop.errors import InvalidValueError


class Body:
    """Its tip moves by one metre a physics step."""

    def __init__(self):
        self.steps = 0

    def tip_in_world(self):
        return np.array([float(self.steps), 0.0, 0.0])

    def tip_velocity_in_world(self):
        return np.array([1.0, 0.0, 0.0])

    def contact_force_in_world(self):
        return np.array([0.0, 0.0, 2.0])


def run(config, periods=5, seed=0):
    body = Body()
    channels = Proprioception(body, config, physics_steps_per_control=4)
    channels.reset(np.random.RandomState(seed))
    readings = []
    for _ in range(periods):
        channels.before_control_period()
        for _ in range(4):
            body.steps += 1
            channels.after_physics_step()
        readings.append(channels.read())
    return readings


def test_without_delay_the_newest_state_is_read():
    assert [reading.tip_in_world[0] for reading in run(ProprioceptionConfig())] == [4.0, 8.0, 12.0, 16.0, 20.0]


def test_a_delay_is_counted_in_physics_steps_and_starts_with_the_first_reading_not_with_zeros():
    readings = run(ProprioceptionConfig(kinematics_delay_steps=6, force_delay_steps=6))
    assert [reading.tip_in_world[0] for reading in readings] == [0.0, 2.0, 6.0, 10.0, 14.0]
    assert readings[0].contact_force_in_world[2] == 2.0


def test_force_noise_is_seeded():
    noisy = ProprioceptionConfig(force_noise_n=0.1)
    first, again, other = (run(noisy, seed=seed)[-1].contact_force_in_world for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first[2] != 2.0


@pytest.mark.parametrize("name", ["kinematics_delay_steps", "force_delay_steps", "force_noise_n"])
def test_negative_values_are_refused(name):
    with pytest.raises(InvalidValueError, match=name):
        ProprioceptionConfig(**{name: -1})
