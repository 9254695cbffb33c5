import pytest

from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.fidelity import with_fidelity
from laploop.envs.tasks.configs import ReachConfig
from laploop.errors import InvalidValueError, UnknownNameError


def test_full_is_the_default_of_every_task():
    assert with_fidelity(ReachConfig(), "full") == ReachConfig()


def test_fast_has_longer_steps_and_a_coarser_contact_and_full_leads_back():
    fast = with_fidelity(ReachConfig(max_seconds=7.0), "fast")
    assert fast.loop.physics_ns == 4_000_000
    assert fast.loop.theatre.tissue.contact_every == 2
    assert fast.max_seconds == 7.0
    assert with_fidelity(fast, "full") == ReachConfig(max_seconds=7.0)


def test_an_episode_takes_it_as_an_option():
    episode = EpisodeConfig.of(task="track", fidelity="fast", motion="both")
    assert episode.task.loop.physics_hz == 250.0
    assert episode.motion_name() == "both"


def test_unknown_and_impossible_ones_are_refused():
    with pytest.raises(UnknownNameError, match="quick"):
        with_fidelity(ReachConfig(), "quick")
    # A robot of the e-series takes a target every 2 ms.
    with pytest.raises(InvalidValueError, match="cycle_ms"):
        EpisodeConfig.of(actuation="ur5-e", fidelity="fast")
