import numpy as np
import pytest

from laploop.envs.loop.proprioception import Proprioception, ProprioceptionConfig
from laploop.envs.theatre.clock_rates import ClockRates
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


def run(config, periods=5, seed=0, body=None):
    body = body or Body()
    channels = Proprioception(body, config, ClockRates())
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


def test_a_delay_is_rounded_up_to_physics_steps_and_starts_with_the_first_reading_not_with_zeros():
    # 10.1 ms are six steps of 2 ms.
    readings = run(ProprioceptionConfig(kinematics_delay_ms=10.1, force_delay_ms=12.0))
    assert [reading.tip_in_world[0] for reading in readings] == [0.0, 2.0, 6.0, 10.0, 14.0]
    assert readings[0].contact_force_in_world[2] == 2.0


def test_the_force_is_the_mean_over_its_window():
    class Ramp(Body):
        def contact_force_in_world(self):
            return np.array([0.0, 0.0, float(self.steps)])

    # Steps 17 to 20 lie in the last of five periods of four steps.
    assert run(ProprioceptionConfig(force_window_steps=4), body=Ramp())[-1].contact_force_in_world[2] == pytest.approx(18.5)
    assert run(ProprioceptionConfig(force_window_steps=1), body=Ramp())[-1].contact_force_in_world[2] == pytest.approx(20.0)
    # The first readings of an episode are the first value, not zeros that it is averaged with.
    assert run(ProprioceptionConfig(force_window_steps=8), periods=1)[0].contact_force_in_world[2] == pytest.approx(2.0)


def test_force_noise_is_seeded():
    noisy = ProprioceptionConfig(force_noise_n=0.1)
    first, again, other = (run(noisy, seed=seed)[-1].contact_force_in_world for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first[2] != 2.0


@pytest.mark.parametrize("name", ["kinematics_delay_ms", "force_delay_ms", "force_noise_n", "force_window_steps"])
def test_negative_values_are_refused(name):
    with pytest.raises(InvalidValueError, match=name):
        ProprioceptionConfig(**{name: -1})
