"""An environment of a vector does, bit for bit, what it does alone."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from laploop.envs.learning.reach import ReachLearnerEnv
from laploop.envs.tasks.registry import make_environment
from laploop.errors import SimulationError, WorkerError

SEED = 3


def actions(count, step):
    """Return the actions of a step, another one for each environment: the tips go on circles and slowly down."""
    angles = 0.3 * step + np.arange(count)
    return 0.02 * np.stack([np.cos(angles), np.sin(angles), np.full(count, 0.5)], axis=1).astype(np.float32)


def keyed(seen, number=None):
    """Return an observation, or that of an environment of a vector, as a dictionary."""
    parts = seen if isinstance(seen, dict) else {"vector": seen}
    return parts if number is None else {key: values[number] for key, values in parts.items()}


def play_alone(env, number, count, steps, mode):
    """Return, for each step of a single environment: observation, reward, both ends, info, an ended episode's observation."""
    seen, info = env.reset(seed=SEED + number)
    told = [(keyed(seen), 0.0, False, False, info, None)]
    over = False
    for step in range(steps):
        last = None
        if over and mode is AutoresetMode.NEXT_STEP:
            (seen, info), reward, terminated, truncated = env.reset(), 0.0, False, False
        else:
            seen, reward, terminated, truncated, info = env.step(actions(count, step)[number])
        over = terminated or truncated
        if over and mode is AutoresetMode.SAME_STEP:
            last = keyed(seen)
            seen, info = env.reset()
        told.append((keyed(seen), reward, terminated, truncated, info, last))
    env.close()
    return told


def play_together(vector, steps):
    """Return the same of every environment of a vector, with the infos of all."""
    count = vector.num_envs
    seen, infos = vector.reset(seed=SEED)
    told = [[(keyed(seen, number), 0.0, False, False, infos, None)] for number in range(count)]
    for step in range(steps):
        seen, rewards, terminated, truncated, infos = vector.step(actions(count, step))
        for number, rows in enumerate(told):
            ended = "final_obs" in infos and infos["_final_obs"][number]
            last = keyed(infos["final_obs"][number]) if ended else None
            rows.append((keyed(seen, number), rewards[number], terminated[number], truncated[number], infos, last))
    return told


def assert_same(alone, together, number):
    """Compare an environment's steps bit for bit; return how many episodes ended in them."""
    for step, (one, other) in enumerate(zip(alone, together, strict=True)):
        assert one[1:4] == other[1:4], step
        for mine, theirs in ((one[0], other[0]), (one[5], other[5])):
            assert (mine is None) == (theirs is None), step
            for key in mine or ():
                np.testing.assert_array_equal(mine[key], theirs[key], err_msg=f"{key} of step {step}")
        for key in ("contact_force_n", "sim_s", "target_error_mm", "frames"):
            assert one[4][key] == other[4][key][number], (key, step)
    return sum(row[2] or row[3] for row in alone)


def compare(vector, config, steps, mode):
    """Play a vector and each of its environments alone; return how many episodes ended in all."""
    together = play_together(vector, steps)
    ended = 0
    for number, rows in enumerate(together):
        env = make_environment("reach", config=config, perception="oracle")
        ended += assert_same(play_alone(env, number, len(together), steps, mode), rows, number)
    return ended


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_state_is_that_of_single_environments_through_autoreset(vector, coarse_config, mode):
    config = coarse_config()
    # Episodes last ten steps.
    assert compare(vector(2, config=config, autoreset_mode=mode, threads=2), config, 14, mode) == 2


@pytest.mark.parametrize("observed", ["stripes", "depth"])
def test_images_and_exact_depth_are_those_of_single_environments(vector, coarse_config, observed):
    config = coarse_config(observation_mode=observed)
    assert compare(vector(2, config=config), config, 7, AutoresetMode.NEXT_STEP) == 0


def test_worker_processes_give_the_same_bits_and_end_with_one_that_dies(vector, coarse_config):
    # One test, since starting processes takes seconds.
    config = coarse_config()
    made = vector(3, config=config, workers=2)
    assert compare(made, config, 12, AutoresetMode.NEXT_STEP) == 3
    assert made.get_attr("task") == ("reach",) * 3
    with pytest.raises(WorkerError, match="cannot be sent to another process"):
        made.get_attr("loop")
    processes = [group._process for group in made._groups]
    processes[1].kill()
    with pytest.raises(WorkerError, match="died with exit code -9"):
        made.step(actions(3, 0))
    assert not any(process.is_alive() for process in processes)
    with pytest.raises(SimulationError, match="closed"):
        made.step(actions(3, 0))


def test_learners_make_vectors_by_gymnasium(coarse_config):
    keywords = {"config": coarse_config(), "observation": "state", "workers": 1}
    vector = gym.make_vec("laploop/Reach-v1", num_envs=2, vectorization_mode="vector_entry_point", **keywords)
    rows = play_together(vector, 3)[1]
    alone = play_alone(ReachLearnerEnv(config=coarse_config(), observation="state"), 1, 2, 3, AutoresetMode.NEXT_STEP)
    assert assert_same(alone, rows, 1) == 1
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    vector.close()


@pytest.mark.slow
@pytest.mark.parametrize(("count", "threads", "workers"), [(1, 1, 1), (3, 2, 1), (8, 1, 2), (8, 2, 2)])
@pytest.mark.parametrize("observed", ["state", "stripes", "depth"])
def test_500_steps_are_those_of_single_environments(vector, coarse_config, observed, count, threads, workers):
    # Each episode takes 96 steps, so that five of them end.
    config = coarse_config(observation_mode=observed, max_seconds=0.808)
    made = vector(count, config=config, threads=threads, workers=workers)
    assert compare(made, config, 500, AutoresetMode.NEXT_STEP) == 5 * count
