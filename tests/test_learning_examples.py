import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest
from demonstration_files import card_of, made_up

import laploop  # noqa: F401  registers the environments
from laploop.studies.demonstrations.lerobot_writer import write_lerobot
from laploop.studies.demonstrations.minari_format import write_minari

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples" / "learning"
FEW = ("--steps", "16", "--episodes", "1")
RLLIB = os.environ.get("RLLIB_PYTHON", sys.executable)
CLONED = {"observation": "depth+state", "perception": "oracle", "fidelity": "fast"}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run an example for a few steps in this process, where what all of them import is imported once."""
    monkeypatch.chdir(tmp_path)

    def run(script, *arguments):
        monkeypatch.setattr(sys, "argv", [script, *FEW, "--out", "out", *arguments])
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")

    return run


def run_alone(tmp_path, script, *arguments, python=sys.executable):
    """Run an example as a process of its own."""
    subprocess.run(  # noqa: S603  our own scripts
        [python, "-P", str(EXAMPLES / script), *FEW, "--out", "out", *arguments],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        check=True,
    )


def check(tmp_path, task, folder="out"):
    result = json.loads((tmp_path / folder / "summary.json").read_text())
    assert result["environment"] == task
    assert len(result["rows"]) == 1
    assert (tmp_path / folder / "policy.safetensors").is_file()
    assert (tmp_path / folder / "policy.json").is_file()
    assert (tmp_path / folder / "curve.csv").read_text().startswith("steps,wall_s,cpu_s,total_return,length,success\n")


@pytest.mark.parametrize("script", ["ppo.py", "sac.py", "tqc.py"])
def test_learners_of_reach_run(run, tmp_path, script):
    run(script)
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.slow
@pytest.mark.parametrize("script", ["ppo.py", "sac.py", "tqc.py"])
def test_learners_go_on_from_their_policies(run, tmp_path, script):
    run(script)
    run(script, "--resume")
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.slow
def test_ppo_runs_on_two_workers(tmp_path):
    run_alone(tmp_path, "ppo.py", "--workers", "2")
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.parametrize(
    "treatment",
    [pytest.param("naive", marks=pytest.mark.slow), pytest.param("augmented", marks=pytest.mark.slow), "conservative"],
)
def test_treatments_of_a_delay_run(run, tmp_path, treatment):
    run("delayed_ppo.py", "--treatment", treatment)
    check(tmp_path, "laploop/Track-v1")


def test_residual_learning_runs_and_tells_of_the_controller_alone(run, tmp_path):
    run("residual_rl.py")
    check(tmp_path, "laploop/Track-v1")
    assert json.loads((tmp_path / "out" / "base" / "summary.json").read_text())["steps"] == 0


def write_demonstrations(folder, form="minari", **changes):
    """Write a data set of two episodes such as the one to clone, apart from changes to its card."""
    card = card_of(**{"keywords": CLONED, **changes})
    env = gym.make("laploop/Reach-v1", **CLONED)
    episodes = [made_up(seed, space=env.observation_space) for seed in (3, 4)]
    place = folder / "minari" / "laploop" / "reach-v0" / "data" if form == "minari" else folder / "lerobot"
    place.mkdir(parents=True)
    if form == "minari":
        write_minari(place, card, env, episodes)
    else:
        write_lerobot(place, card, episodes)
    env.close()


@pytest.mark.parametrize("form", ["minari", pytest.param("lerobot", marks=pytest.mark.slow)])
def test_cloning_runs_on_demonstrations(run, tmp_path, capsys, form):
    write_demonstrations(tmp_path / "data", form)
    run("behaviour_cloning.py", "--data", "data")
    assert "2 episodes, 7 decisions" in capsys.readouterr().out
    check(tmp_path, "laploop/Reach-v1")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"task": "look", "environment": "laploop/Look-v1"}, "laploop/Look-v1"),
        ({"keywords": {"fidelity": "fast"}}, "{'fidelity': 'fast'}"),
        ({"keywords": {**CLONED, "perception": "compact"}}, "compact"),
        ({"laploop": "0.0.1"}, "made by laploop 0.0.1"),
        (None, "does not hold demonstrations"),
    ],
    ids=["task", "observation", "estimator", "version", "none"],
)
def test_cloning_tells_how_to_make_the_data_set_that_it_needs(run, tmp_path, capsys, changes, words):
    if changes is not None:
        write_demonstrations(tmp_path / "data", **changes)
    with pytest.raises(SystemExit, match="2"):
        run("behaviour_cloning.py", "--data", "data")
    error = capsys.readouterr().err
    assert words in error
    assert "laploop demonstrate --task reach --observation depth+state --fidelity fast --perception oracle" in error
    assert not (tmp_path / "out").exists()


def has_rllib():
    """Whether the Python that may run RLlib can import it."""
    return subprocess.run([RLLIB, "-P", "-c", "import ray.rllib"], capture_output=True, check=False).returncode == 0  # noqa: S603


@pytest.mark.slow
def test_rllib_runs(tmp_path):
    """RLlib asks for an older Gymnasium than laploop is tested with, and so may live in a Python environment of its own.

    After `pip install 'laploop[learning,ray]' 'ray[rllib]'` there, `RLLIB_PYTHON=ENVIRONMENT/bin/python make test-slow` runs
    it. Without the variable it runs here; it is skipped where `ray.rllib` cannot be imported.
    """
    if not has_rllib():
        pytest.skip(f"{RLLIB} cannot import ray.rllib; RLLIB_PYTHON names a Python that can")
    run_alone(tmp_path, "rllib.py", python=RLLIB)
    check(tmp_path, "laploop/Reach-v1")
