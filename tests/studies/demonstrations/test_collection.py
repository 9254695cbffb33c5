import numpy as np
import pytest

from laploop.errors import InvalidValueError, SimulationError
from laploop.studies.demonstrations import collection as module
from laploop.studies.demonstrations import config as config_module
from laploop.studies.demonstrations.collection import collect
from laploop.studies.demonstrations.config import CollectionConfig
from laploop.studies.demonstrations.dataset import make_dataset, summarise
from laploop.studies.demonstrations.episode_folder import EpisodeFolder


@pytest.fixture
def runs(monkeypatch, episode):
    """Seeds that were run; odd ones fail at the task, 6 cannot be run the first time, and 8 interrupts the first time."""
    ran = []

    def demonstrate(config, seed):
        first = seed not in ran
        ran.append(seed)
        if seed == 6 and first:
            raise SimulationError("too soft")
        if seed == 8 and first:
            raise KeyboardInterrupt
        return episode(seed, success=seed % 2 == 0)

    monkeypatch.setattr(module, "demonstrate", demonstrate)
    return ran


def seeds(outcomes):
    return [one["seed"] for one in outcomes]


def test_all_episodes_are_kept_in_the_order_of_their_seeds(runs, reach, tmp_path):
    told = []
    found = collect(reach(), CollectionConfig(episodes=4, keep="all", seed=2), tmp_path, told.append)
    assert seeds(found.kept) == [2, 3, 4, 5]
    assert found.dropped == ()
    assert told == [1, 2, 3, 4]


def test_further_seeds_take_the_place_of_failures(runs, reach, tmp_path):
    found = collect(reach(), CollectionConfig(episodes=3), tmp_path)
    assert seeds(found.kept) == [0, 2, 4]
    assert seeds(found.dropped) == [1, 3]
    assert runs == [0, 1, 2, 3, 4]
    summary = summarise(found, 3)
    assert (summary["tried"], summary["success_rate"]) == (5, 0.6)


def test_an_episode_that_cannot_be_run_is_told_and_tried_again_the_next_time(runs, reach, tmp_path):
    wanted = CollectionConfig(episodes=2, keep="all", seed=6)
    found = collect(reach(), CollectionConfig(episodes=1, keep="all", seed=6), tmp_path)
    assert found.dropped[0]["error"] == "too soft"
    assert seeds(found.kept) == [7]
    assert seeds(collect(reach(), wanted, tmp_path).kept) == [6, 7]
    assert runs == [6, 7, 6]


def test_an_interrupted_collection_goes_on_where_it_was_to_the_same_episodes(runs, reach, tmp_path, episode):
    wanted = CollectionConfig(episodes=3, keep="all", seed=7)
    with pytest.raises(KeyboardInterrupt):
        collect(reach(), wanted, tmp_path)
    found = collect(reach(), wanted, tmp_path)
    assert runs == [7, 8, 8, 9]
    loaded = EpisodeFolder(tmp_path / "episodes", reach().key).load(7)
    np.testing.assert_array_equal(loaded.actions, episode(7).actions)
    np.testing.assert_array_equal(loaded.observations["state"], episode(7).observations["state"])
    assert loaded.outcome == found.kept[0]


def test_episodes_of_another_configuration_do_not_count(runs, reach, tmp_path):
    collect(reach(), CollectionConfig(episodes=1), tmp_path)
    collect(reach(observation="depth"), CollectionConfig(episodes=1), tmp_path)
    assert runs == [0, 0]


def test_episodes_of_other_code_do_not_count(runs, reach, tmp_path, monkeypatch):
    collect(reach(), CollectionConfig(episodes=1), tmp_path)
    monkeypatch.setattr(config_module, "code_digest", lambda study: f"other code of {study}")
    collect(reach(), CollectionConfig(episodes=1), tmp_path)
    collect(reach(), CollectionConfig(episodes=1), tmp_path)
    assert runs == [0, 0]


def test_a_collection_ends_with_fewer_when_too_many_fail(monkeypatch, reach, tmp_path, episode):
    monkeypatch.setattr(module, "demonstrate", lambda config, seed: episode(seed, success=seed == 4))
    found = collect(reach(), CollectionConfig(episodes=2), tmp_path)
    assert seeds(found.kept) == [4]
    assert len(found.dropped) == 9
    monkeypatch.setattr(module, "demonstrate", lambda config, seed: episode(seed, success=False))
    with pytest.raises(SimulationError, match="none of 5 episodes"):
        make_dataset(reach(), CollectionConfig(episodes=1, seed=20), "lerobot", tmp_path)
    assert not (tmp_path / "lerobot").exists()


def test_a_damaged_file_is_named(runs, reach, tmp_path):
    collect(reach(), CollectionConfig(episodes=1), tmp_path)
    path = tmp_path / "episodes" / "seed_000000.npz"
    content = path.read_bytes()
    for damaged in (b"", content[:200], b"x" * 100):
        path.write_bytes(damaged)
        with pytest.raises(InvalidValueError, match=r"seed_000000.npz.*remove the file"):
            collect(reach(), CollectionConfig(episodes=1), tmp_path)


@pytest.mark.parametrize("changes", [{"episodes": 0}, {"keep": "failures"}, {"workers": 0}, {"seed": -1}])
def test_bad_collections_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        CollectionConfig(**changes)
