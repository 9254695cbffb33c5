import io
import json
import re

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from laploop.envs.learning.encoding import decode_depth
from laploop.errors import DatasetError, InvalidValueError, UnknownNameError
from laploop.studies.demonstrations import lerobot_writer
from laploop.studies.demonstrations.lerobot_reader import LeRobotDemonstrations
from laploop.studies.demonstrations.lerobot_writer import write_lerobot
from laploop.studies.demonstrations.minari_format import MinariDemonstrations, dataset_id, write_minari
from laploop.studies.demonstrations.recorded import open_demonstrations

OBSERVATIONS = ("state", "depth", "stripes", "depth+state")


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_minari_returns_what_was_recorded(tmp_path, episode, card, spaces_of, observation):
    minari = pytest.importorskip("minari")
    written = [episode(seed, observation=observation, success=seed != 4) for seed in (3, 4, 5)]
    write_minari(tmp_path, card(observation), spaces_of(observation), iter(written))
    dataset = minari.MinariDataset(tmp_path)
    assert dataset.total_episodes == 3
    assert dataset.total_steps == sum(len(one.actions) for one in written)
    assert dataset.observation_space == spaces_of(observation).observation_space
    for one, found in zip(written, dataset, strict=True):
        observed = found.observations if isinstance(found.observations, dict) else {"state": found.observations}
        assert observed.keys() == one.observations.keys()
        for key, array in one.observations.items():
            np.testing.assert_array_equal(observed[key], array)
            assert observed[key].dtype == array.dtype
        np.testing.assert_array_equal(found.actions, one.actions)
        np.testing.assert_array_equal(found.rewards, one.rewards)
        np.testing.assert_array_equal(found.terminations, one.terminations)
        np.testing.assert_array_equal(found.truncations, one.truncations)
        np.testing.assert_array_equal(found.infos["expert_action"], one.expert_actions)
        np.testing.assert_array_equal(found.infos["privileged"], one.privileged)
        np.testing.assert_array_equal(found.infos["is_success"], one.successes)
    (metadata,) = dataset.storage.get_episode_metadata([1])
    assert metadata["seed"] == 4
    read = MinariDemonstrations(tmp_path).episode(1)
    assert read.outcome == written[1].outcome
    np.testing.assert_array_equal(read.expert_actions, written[1].expert_actions[:-1])


def test_minari_finds_the_data_set_by_its_id(tmp_path, episode, card, spaces_of, monkeypatch):
    minari = pytest.importorskip("minari")
    folder = tmp_path / dataset_id("reach") / "data"
    folder.mkdir(parents=True)
    write_minari(folder, card(), spaces_of("state"), [episode(3)])
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    assert len(minari.load_dataset("laploop/reach-v0")) == 1
    assert list(minari.list_local_datasets()) == ["laploop/reach-v0"]


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_lerobot_files_hold_what_was_recorded(tmp_path, episode, card, observation):
    written = [episode(seed, observation=observation, success=seed != 4) for seed in (3, 4, 5)]
    write_lerobot(tmp_path, card(observation), iter(written))
    rows = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet").to_pylist()
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["fps"], info["total_episodes"], info["total_frames"]) == (25, 3, len(rows))
    assert set(info["features"]) == set(rows[0])
    episodes = pq.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for one, described in zip(written, episodes, strict=True):
        own = rows[described["dataset_from_index"] : described["dataset_to_index"]]
        assert len(own) == described["length"] == len(one.actions)
        assert {row["episode_index"] for row in own} == {described["episode_index"]}
        assert [row["frame_index"] for row in own] == list(range(len(own)))
        np.testing.assert_array_equal([row["timestamp"] for row in own], np.arange(len(own), dtype=np.float32) / np.float32(25))
        np.testing.assert_array_equal(np.array([row["action"] for row in own], np.float32), one.actions)
        np.testing.assert_array_equal(np.array([row["expert_action"] for row in own], np.float32), one.expert_actions[:-1])
        np.testing.assert_array_equal(np.array([row["next.reward"] for row in own]), one.rewards.astype(np.float32))
        assert [row["next.done"] for row in own] == (one.terminations | one.truncations).tolist()
        assert [row["next.success"] for row in own] == one.successes[1:].tolist()
        vector = one.observations.get("state", one.observations.get("proprioception"))
        np.testing.assert_array_equal(np.array([row["observation.state"] for row in own], np.float32), vector[:-1])
        for number, row in enumerate(own):
            if "depth" in one.observations:
                image = np.array(Image.open(io.BytesIO(row["observation.images.depth"]["bytes"])))
                depth_mm = decode_depth(one.observations["depth"][number])
                np.testing.assert_array_equal(image, np.nan_to_num(depth_mm))
                assert image.dtype == np.float32
            elif "stripes" in one.observations:
                image = np.array(Image.open(io.BytesIO(row["observation.images.stripes"]["bytes"])))
                np.testing.assert_array_equal(image, np.repeat(one.observations["stripes"][number], 3, axis=-1))


@pytest.mark.parametrize("observation", OBSERVATIONS)
def test_the_reader_of_lerobot_gives_the_environments_observations_again(tmp_path, episode, card, observation):
    written = [episode(seed, observation=observation, success=seed != 4) for seed in (3, 4, 5)]
    write_lerobot(tmp_path, card(observation), iter(written))
    found = LeRobotDemonstrations(tmp_path)
    assert found.card == card(observation)
    for number, one in enumerate(written):
        read = found.episode(number)
        assert read.observations.keys() == one.observations.keys()
        for key, array in one.observations.items():
            np.testing.assert_array_equal(read.observations[key], array[:-1])
            assert read.observations[key].dtype == array.dtype
        np.testing.assert_array_equal(read.expert_actions, one.expert_actions[:-1])
        np.testing.assert_array_equal(read.terminations, one.terminations)
        np.testing.assert_array_equal(read.truncations, one.truncations)
        assert read.outcome == one.outcome


def test_lerobot_says_of_depth_what_it_is(tmp_path, episode, card):
    write_lerobot(tmp_path, card("depth"), [episode(3, observation="depth")])
    feature = json.loads((tmp_path / "meta/info.json").read_text())["features"]["observation.images.depth"]
    assert feature["shape"] == [48, 40, 1]
    assert feature["info"] == {
        "is_depth_map": True,
        "depth_unit": "mm",
        "depth_min_mm": 40.0,
        "depth_max_mm": 160.0,
        "invalid": 0.0,
    }


def test_lerobot_statistics_are_those_of_all_rows(tmp_path, episode, card):
    written = [episode(seed, observation="stripes") for seed in (3, 4, 5)]
    write_lerobot(tmp_path, card("stripes"), written)
    stats = json.loads((tmp_path / "meta/stats.json").read_text())
    actions = np.concatenate([one.actions for one in written])
    assert stats["action"]["count"] == [len(actions)]
    for name, value in (("min", actions.min(0)), ("max", actions.max(0)), ("mean", actions.mean(0)), ("std", actions.std(0))):
        np.testing.assert_allclose(stats["action"][name], value, rtol=1e-5)
    images = np.concatenate([one.observations["stripes"][:-1] for one in written]) / 255.0
    assert np.shape(stats["observation.images.stripes"]["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(stats["observation.images.stripes"]["std"], np.full((3, 1, 1), images.std()), rtol=1e-6)


def test_lerobot_tasks_have_the_index_that_pandas_looks_for(tmp_path, episode, card):
    write_lerobot(tmp_path, card(), [episode(3)])
    table = pq.read_table(tmp_path / "meta/tasks.parquet")
    assert table.to_pydict() == {"task_index": [0], "task": ["Touch the point."]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def test_lerobot_begins_a_new_file_when_one_is_full(tmp_path, episode, card, monkeypatch):
    monkeypatch.setattr(lerobot_writer, "FILE_MB", 1e-4)
    monkeypatch.setattr(lerobot_writer, "CHUNK_FILES", 2)
    written = [episode(seed) for seed in (3, 4, 5)]
    write_lerobot(tmp_path, card(), written)
    files = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.glob("data/*/*"))
    assert files == [f"data/chunk-00{chunk}/file-00{file}.parquet" for chunk, file in ((0, 0), (0, 1), (1, 0))]
    np.testing.assert_array_equal(LeRobotDemonstrations(tmp_path).episode(2).actions, written[2].actions)


def test_lerobot_wants_a_whole_number_of_decisions_a_second(tmp_path, episode, card):
    with pytest.raises(InvalidValueError, match="whole number a second"):
        write_lerobot(tmp_path, card(decision_period_ms=48.0), [episode(3)])


def test_data_sets_that_cannot_be_used_are_refused(tmp_path, episode, card, spaces_of):
    pytest.importorskip("minari")
    with pytest.raises(DatasetError, match="does not hold demonstrations"):
        open_demonstrations(tmp_path)
    old, unknown, ours, foreign = (tmp_path / name for name in ("old", "unknown", "ours", "foreign"))
    for folder in (old, unknown, ours, foreign):
        folder.mkdir()
    write_lerobot(old, card(laploop="0.0.1"), [episode(3)])
    with pytest.raises(DatasetError, match=r"made by laploop 0\.0\.1, this is"):
        open_demonstrations(old)
    for change, words in (
        ({"layout": 7}, f"the card of {old} has the layout 7; allowed: 1; make the data set again"),
        ({"keywords": 5}, f"the card of {old} is damaged: keywords is 5"),
        ({"episodes": None}, "tells of none of the 1 episodes"),
    ):
        described = {**card().plain, "episodes": [episode(3).outcome], **change}
        (old / "meta" / "laploop.json").write_text(json.dumps(described))
        with pytest.raises(DatasetError, match=re.escape(words)):
            open_demonstrations(old)
    (old / "meta" / "info.json").write_text('{"codebase_version": "v2.1"}')
    with pytest.raises(DatasetError, match=r"info\.json has the codebase_version 'v2\.1'; allowed: 'v3\.0'"):
        open_demonstrations(old)
    write_minari(unknown, card(task="rech"), spaces_of("state"), [episode(3)])
    with pytest.raises(UnknownNameError, match="did you mean 'reach'"):
        open_demonstrations(unknown)
    write_minari(ours, card(), spaces_of("state"), [episode(3)])
    found = open_demonstrations(ours)
    for index in (-1, 1):
        with pytest.raises(InvalidValueError, match="0 to 0"):
            found.episode(index)
    part = next(ours.glob("0/*.parquet"))
    part.write_bytes(part.read_bytes()[:50])
    with pytest.raises(DatasetError, match="episode 0 of"):
        found.episode(0)
    (foreign / "metadata.json").write_text('{"total_episodes": 3}')
    with pytest.raises(DatasetError, match="does not hold demonstrations"):
        open_demonstrations(foreign)
    (foreign / "metadata.json").write_text("{")
    with pytest.raises(DatasetError, match="cannot be read"):
        open_demonstrations(foreign)
