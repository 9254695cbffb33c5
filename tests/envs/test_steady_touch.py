"""A touch is steady: no physics step without contact while tissue breathes, hardly any while it also beats."""

import numpy as np
import pytest

from laploop.control.controllers.phase import Phase
from laploop.control.controllers.reach import ReachController
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.theatre import Theatre

STEP_S = 0.002
SETTLING_S = 0.2
"""After the first touch; the hold counts from here on."""
WINDOW_S = 0.04


def held_forces(motion, seed, perception="compact", hold_s=3.0):
    """Return the force on the tip in every physics step of a hold, newtons, without its first 0.2 s."""
    task = EpisodeConfig.of(motion=motion, seconds=10.0 + hold_s, hold_s=hold_s).task
    env = ReachEnv(task, perception=perception)
    controller = ReachController(env.loop.rig)
    forces, began = [], None
    with pytest.MonkeyPatch.context() as patch:
        stepping = Theatre.stepping

        def logged(theatre):
            yield from stepping(theatre)
            forces.append(float(np.linalg.norm(theatre.contact_force_in_world())))

        patch.setattr(Theatre, "stepping", logged)
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(controller.command(env.control_input()).astype(np.float32))
            over = terminated or truncated
            began = began if controller.phase is Phase.TOUCH else None
            began = len(forces) if began is None and controller.phase is Phase.TOUCH else began
    env.close()
    assert info["success"], seed
    return np.array(forces[began + round(SETTLING_S / STEP_S) :])


def steady_fraction(forces):
    """Return the fraction of 40 ms means that lie within a quarter of the hold's mean."""
    steps = round(WINDOW_S / STEP_S)
    means = forces[: len(forces) // steps * steps].reshape(-1, steps).mean(axis=1)
    return float((np.abs(means - forces.mean()) <= 0.25 * forces.mean()).mean())


def check_breathing(seed):
    forces = held_forces("breathing", seed)
    assert (forces == 0.0).sum() == 0, seed
    # Newtons: the force that is asked for.
    assert 0.03 < forces.mean() < 0.05, seed
    assert steady_fraction(forces) >= 0.9, seed


def test_breathing_tissue_is_never_let_go():
    check_breathing(0)


def test_tissue_that_also_beats_is_hardly_ever_let_go():
    forces = held_forces("both", 1)
    assert (forces == 0.0).mean() <= 0.01
    assert forces.mean() < 0.15


@pytest.mark.slow
def test_twenty_breathing_tissues_are_never_let_go():
    for seed in range(20):
        check_breathing(seed)


@pytest.mark.slow
def test_twenty_tissues_that_also_beat_are_hardly_ever_let_go():
    lost = [(held_forces("both", seed) == 0.0).mean() for seed in range(20)]
    assert np.mean(lost) <= 0.01
    assert max(lost) <= 0.02
