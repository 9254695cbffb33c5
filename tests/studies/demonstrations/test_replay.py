from dataclasses import replace

import numpy as np
import pytest

from laploop.envs.recording.recorder import NullRecorder
from laploop.envs.tasks.registry import TASKS
from laploop.errors import DatasetError, InvalidValueError
from laploop.studies.code_digest import code_digest
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.config import CollectionConfig, Perturbation
from laploop.studies.demonstrations.dataset import make_dataset
from laploop.studies.demonstrations.demonstration import demonstrate, make_learner
from laploop.studies.demonstrations.expert import Expert
from laploop.studies.demonstrations.recorded import RecordedEpisode, open_demonstrations
from laploop.studies.demonstrations.replay import replay


class InMemory:
    """A data set of one episode that was never written."""

    count = 1

    def __init__(self, config, demonstration, **changes):
        env, learner = make_learner(config)
        try:
            self.card = Card.of(config, "all", learner, Expert(learner).parameters)
        finally:
            env.close()
        names = ("observations", "actions", "expert_actions", "rewards", "terminations", "truncations", "outcome")
        self.recorded = RecordedEpisode(**{**{name: getattr(demonstration, name) for name in names}, **changes})

    def episode(self, index):
        return self.recorded


def test_an_episode_with_pushes_and_other_tissue_replays_to_the_bit_from_both_formats(short, reach, tmp_path):
    pytest.importorskip("minari")
    young = {"loop.theatre.tissue.material.young_pa": {"uniform": [5000, 9000]}}
    # Pushes begin within 0.2 s, so that the 0.4 s have some.
    config = reach(randomisation=young, perturbation=Perturbation(pushes=5, push_fraction=0.02))
    for name in ("minari", "lerobot"):
        path, collected = make_dataset(config, CollectionConfig(episodes=1, seed=3), name, tmp_path)
        assert collected.kept[0]["pushes"]
        found = open_demonstrations(path)
        assert found.card.config().keywords == config.keywords
        result = replay(found, 0)
        assert result.frames == found.episode(0).actions.shape[0] + 1 == 10
        assert result.differing_frames == 0
        assert result.differences == ()


@pytest.mark.parametrize("observation", ["depth+state", "stripes"])
def test_images_replay_to_the_bit(short, reach, observation):
    config = reach(observation)
    assert replay(InMemory(config, demonstrate(config, 2)), 0).differences == ()


def test_what_differs_is_told_with_frame_key_and_size(short, reach):
    config = reach()
    demonstration = demonstrate(config, 2)
    actions = demonstration.actions.copy()
    actions[6] *= -1.0
    result = replay(InMemory(config, demonstration, actions=actions), 0)
    assert [one.frame for one in result.differences if one.what == "state"] == [7, 8, 9]
    assert result.differing_frames == 3
    assert all(one.entries > 0 and one.largest > 0.0 for one in result.differences)
    rewards = demonstration.rewards.copy()
    rewards[3] = np.nextafter(rewards[3], 9.0)
    (one,) = replay(InMemory(config, demonstration, rewards=rewards), 0).differences
    assert (one.frame, one.what, one.entries) == (4, "reward", 1)
    (one,) = replay(
        InMemory(config, demonstration, outcome={**demonstration.outcome, "randomisation": {"a": 1}}), 0
    ).differences
    assert (one.frame, one.what) == (0, "randomisation")
    longer = np.concatenate([demonstration.actions, demonstration.actions[:2]])
    found = replay(InMemory(config, demonstration, actions=longer), 0).differences
    assert [(one.frame, one.what) for one in found] == [(10, "end")]


def test_an_episode_can_be_watched(short, reach, monkeypatch):
    shown = []

    class Viewer(NullRecorder):
        def tick(self, record):
            shown.append(record.now_ns)

    monkeypatch.setattr("laploop.envs.learning.render.RerunViewer", Viewer)
    config = reach()
    assert replay(InMemory(config, demonstrate(config, 2)), 0, render_mode="human").differences == ()
    # The demonstration itself is not shown, the replay is: a tick every 8 ms.
    assert shown == list(range(48_000_000, 400_000_001, 8_000_000))


def test_a_data_set_that_does_not_fit_its_environment_is_refused(short, reach):
    config = reach()
    made = InMemory(config, demonstrate(config, 2))
    recorded = made.recorded
    made.recorded = replace(recorded, observations={"depth": recorded.observations["state"]})
    with pytest.raises(DatasetError, match="do not fit the environment's state"):
        replay(made, 0)
    made.recorded = replace(recorded, observations={"state": recorded.observations["state"][:, :-1]})
    with pytest.raises(DatasetError, match="in the data set"):
        replay(made, 0)
    made.recorded = replace(recorded, actions=recorded.actions[:, :2])
    with pytest.raises(DatasetError, match="do not fit laploop/Reach-v1"):
        replay(made, 0)
    made.recorded = recorded
    made.card = replace(made.card, keywords={"observtion": "state"})
    with pytest.raises(DatasetError, match="observtion"):
        replay(made, 0)
    made.card = replace(made.card, keywords={"perception": "mine:Estimator"})
    with pytest.raises(InvalidValueError, match="without --trust"):
        replay(made, 0)


def test_the_card_says_how_the_episodes_were_made(reach):
    env, learner = make_learner(reach())
    try:
        card = Card.of(reach(), "success", learner, Expert(learner).parameters)
    finally:
        env.close()
    assert card.environment == "laploop/Reach-v1"
    assert card.keywords == {"fidelity": "fast", "perception": "oracle"}
    assert card.action_scale == 0.06
    assert card.expert["controller"] == "reach"
    assert card.expert["config"]["hold_force_n"] == 0.04
    assert card.expert["estimator"] == "OracleEstimator"
    assert card.expert["perturbation"]["pushes"] == 2
    assert card.instruction.startswith("Bring the tip of the instrument onto a point of the tissue")
    assert card.code == code_digest("demonstrations")
    assert Card.read(card.plain, "here") == card
    before = {name: value for name, value in card.plain.items() if name != "code"}
    assert Card.read(before, "here") == replace(card, code="")


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("task", TASKS.names())
def test_ten_episodes_of_every_task_replay_to_the_bit(task, reach, tmp_path):
    config = replace(reach("depth+state"), task=task)
    path, _ = make_dataset(config, CollectionConfig(episodes=10, keep="all"), "minari", tmp_path)
    found = open_demonstrations(path)
    assert [replay(found, index).differing_frames for index in range(10)] == [0] * 10
