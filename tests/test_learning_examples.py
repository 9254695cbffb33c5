import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import laploop  # noqa: F401  registers the environments

EXAMPLES = Path(__file__).parents[1] / "examples" / "learning"
FEW = ("--steps", "16", "--episodes", "1")


def run(script, tmp_path, *arguments):
    done = subprocess.run(  # noqa: S603  our own scripts
        [sys.executable, "-P", str(EXAMPLES / script), *FEW, "--out", str(tmp_path / "out"), *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done


def check(tmp_path, task, folder="out"):
    result = json.loads((tmp_path / folder / "summary.json").read_text())
    assert result["environment"] == task
    assert len(result["rows"]) == 1
    assert (tmp_path / folder / "policy.safetensors").is_file()
    assert (tmp_path / folder / "policy.json").is_file()
    assert (tmp_path / folder / "curve.csv").read_text().startswith("steps,wall_s,cpu_s,total_return,length,success\n")


def test_sac_runs(tmp_path):
    run("sac.py", tmp_path)
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.slow
def test_ppo_goes_on_from_its_policy(tmp_path):
    run("ppo.py", tmp_path)
    run("ppo.py", tmp_path, "--resume")


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [("ppo.py",), ("ppo.py", "--workers", "2"), ("tqc.py",)], ids=" ".join)
def test_learners_of_reach_run(tmp_path, arguments):
    run(*arguments[:1], tmp_path, *arguments[1:])
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.slow
@pytest.mark.parametrize("treatment", ["naive", "augmented", "conservative"])
def test_treatments_of_a_delay_run(tmp_path, treatment):
    run("delayed_ppo.py", tmp_path, "--treatment", treatment)
    check(tmp_path, "laploop/Track-v1")


@pytest.mark.slow
def test_residual_learning_runs_and_tells_of_the_controller_alone(tmp_path):
    run("residual_rl.py", tmp_path)
    check(tmp_path, "laploop/Track-v1")
    assert json.loads((tmp_path / "out" / "base" / "summary.json").read_text())["steps"] == 0


@pytest.mark.slow
def test_cloning_runs_on_a_minari_data_set(tmp_path):
    from minari.data_collector.episode_buffer import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    env = gym.make("laploop/Reach-v1", observation="depth+state")
    folder = tmp_path / "data" / "minari" / "laploop" / "reach-v0" / "data"
    folder.mkdir(parents=True)
    storage = MinariStorage.new(
        folder,
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
        data_format="parquet",
        jpeg_encoding=False,
    )
    storage.update_metadata({"dataset_id": "laploop/reach-v0", "minari_version": "0.5.4"})
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (6, 3)).astype(np.float32)
    observations = {
        "depth": rng.integers(0, 255, (7, 256, 256, 1), np.uint8),
        "state": rng.normal(size=(7, env.observation_space["state"].shape[0])).astype(np.float32),
    }
    ends = [False] * 5 + [True]
    storage.update_episodes(
        [
            EpisodeBuffer(
                observations=observations,
                actions=actions,
                rewards=[0.0] * 6,
                terminations=ends,
                truncations=[False] * 6,
                infos={},
            )
        ]
    )
    done = run("behaviour_cloning.py", tmp_path, "--data", str(tmp_path / "data"))
    assert "1 episodes, 6 decisions" in done.stdout
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.slow
@pytest.mark.skipif(find_spec("pandas") is None, reason="RLlib needs pandas: pip install 'ray[rllib]'")
def test_rllib_runs(tmp_path):
    run("rllib.py", tmp_path)
    check(tmp_path, "laploop/Reach-v1")


def test_a_missing_data_set_is_told(tmp_path):
    done = subprocess.run(  # noqa: S603  our own scripts
        [sys.executable, "-P", str(EXAMPLES / "behaviour_cloning.py"), "--data", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "laploop demonstrate" in done.stderr
