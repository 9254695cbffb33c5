"""LeRobot's own reader, which asks for other versions than laploop does and so lives in a Python environment of its own.

After `pip install lerobot` there, `LEROBOT_PYTHON=ENVIRONMENT/bin/python make test-slow` runs it.
"""

import os
import subprocess

import numpy as np
import pytest

from laploop.envs.learning.encoding import decode_depth
from laploop.studies.demonstrations.lerobot_writer import write_lerobot

PYTHON = os.environ.get("LEROBOT_PYTHON")

READ = """
import sys
import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

found = LeRobotDataset("laploop/reach", root=sys.argv[1])
rows = [found[number] for number in range(found.num_frames)]
kept = {key: np.stack([np.asarray(row[key]) for row in rows]) for key in rows[0] if key != "task"}
np.savez(sys.argv[2], tasks=np.array([row["task"] for row in rows]), **kept)
"""


@pytest.mark.slow
@pytest.mark.skipif(PYTHON is None, reason="LEROBOT_PYTHON names no Python that has lerobot")
@pytest.mark.parametrize("observation", ["state", "depth", "stripes", "depth+state"])
def test_its_reader_returns_what_was_recorded(tmp_path, episode, card, observation):
    written = [episode(seed, observation=observation) for seed in (3, 4, 5)]
    write_lerobot(tmp_path / "data", card(observation), iter(written))
    offline = {**os.environ, "HF_HUB_OFFLINE": "1", "HF_HOME": str(tmp_path / "home")}
    command = [PYTHON, "-c", READ, str(tmp_path / "data"), str(tmp_path / "read.npz")]
    subprocess.run(command, env=offline, check=True, timeout=300)  # noqa: S603  the Python that the user names
    read = np.load(tmp_path / "read.npz")

    def joined(name):
        return np.concatenate([getattr(one, name) for one in written])

    def seen(key):
        return np.concatenate([one.observations[key][:-1] for one in written])

    lengths = [len(one.actions) for one in written]
    np.testing.assert_array_equal(read["episode_index"], np.repeat(np.arange(3), lengths))
    np.testing.assert_array_equal(read["frame_index"], np.concatenate([np.arange(length) for length in lengths]))
    np.testing.assert_array_equal(read["action"], joined("actions"))
    np.testing.assert_array_equal(read["next.reward"], joined("rewards").astype(np.float32))
    np.testing.assert_array_equal(read["next.done"], joined("terminations") | joined("truncations"))
    np.testing.assert_array_equal(read["observation.state"], seen("state" if "state" in observation else "proprioception"))
    assert set(read["tasks"]) == {card(observation).instruction}
    if "depth" in observation:
        depth_mm = np.stack([np.nan_to_num(decode_depth(image)) for image in seen("depth")])
        images = read["observation.images.depth"]
        np.testing.assert_array_equal(images, depth_mm.reshape(images.shape))
    elif observation == "stripes":
        # Grey values from 0 to 1, three equal channels, as LeRobot gives pictures.
        grey = (seen("stripes")[..., 0] / np.float32(255.0)).astype(np.float32)
        np.testing.assert_allclose(read["observation.images.stripes"], np.repeat(grey[:, None], 3, axis=1), rtol=1e-6)
