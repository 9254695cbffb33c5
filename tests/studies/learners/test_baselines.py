import json
import shutil
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import pytest
from stable_baselines3 import PPO

from laploop.errors import InvalidValueError, UnknownNameError, WorkerError
from laploop.studies.learners import baselines
from laploop.studies.learners.baselines import METHODS, baselines_table, collected, main, thinned, train
from laploop.studies.learners.baselines_figure import draw_curves
from laploop.studies.learners.curve import Curve
from laploop.studies.learners.evaluation import UNSEEN_SEED, EpisodeScore, Training, write_result
from laploop.studies.learners.sb3_policy import save_sb3

EXAMPLES = Path(__file__).parents[3] / "examples" / "learning"
TRAINING = Training(method="ppo", environment="laploop/Reach-v1", keywords={}, seed=0, steps=40000, wall_s=700.0, cpu_s=600.0)
SCORE = EpisodeScore(seed=0, success=True, terminated_by="success", total_return=2.5, steps=40, error_mm=0.5, force_n=0.2)


def make_run(folder, training, successes):
    write_result(folder, training, [replace(SCORE, seed=seed, success=success) for seed, success in enumerate(successes)])
    curve = Curve(folder)
    for number in range(100):
        curve.add(steps=100 * (number + 1), total_return=number / 100.0, length=100, success=float(number >= 50))
    curve.write()


@pytest.fixture(autouse=True)
def tried(monkeypatch):
    """Replace the evaluation in `full`; return the folders that were asked for."""
    asked = []
    monkeypatch.setattr(baselines, "try_in_full", asked.append)
    return asked


@pytest.fixture
def runs(tmp_path):
    make_run(tmp_path / "runs" / "ppo-0", TRAINING, [True] * 10)
    make_run(tmp_path / "runs" / "ppo-1", replace(TRAINING, seed=1), [True] * 8 + [False] * 2)
    alone = replace(TRAINING, method="scripted", environment="laploop/Track-v1", steps=0, cpu_s=0.0)
    write_result(tmp_path / "runs" / "residual-0" / "base", alone, [SCORE])
    return tmp_path / "runs"


def test_every_method_has_its_script():
    scripts = {path.name for path in EXAMPLES.glob("*.py")}
    assert {method.script for method in METHODS.values()} == scripts - {"rllib.py"}


def test_seeds_of_a_method_share_a_line(runs):
    lines = baselines_table(collected(runs)).splitlines()
    assert lines[2] == (
        "| Reach-v1 | ppo | 40 000 | 2 x 10 | 90 % (70-100): 100, 80 | 2.50 (2.50 to 2.50) | 0.50 (0.50 to 0.50) mm | "
        "0.20 (0.20 to 0.20) N | 10 min / 12 min |"
    )
    assert lines[3].startswith("| Track-v1 | scripted |  | 1 x 1 | 100 % (21-100): 100 |")


def test_what_does_not_learn_counts_once(runs):
    shutil.copytree(runs / "residual-0", runs / "residual-1")
    assert baselines_table(collected(runs)).splitlines()[3].startswith("| Track-v1 | scripted |  | 1 x 1 |")


def test_a_curve_is_thinned_by_means_over_equal_parts(runs):
    curve = thinned(runs / "ppo-0")
    assert curve["steps"][0] == 250.0
    assert curve["steps"][-1] == 10_000.0
    assert curve["success"][0] == 0.0
    assert curve["success"][-1] == 1.0
    # The first part ends at 250 decisions: it holds the episodes of the returns 0 and 0.01.
    assert curve["total_return"][0] == pytest.approx(0.005)


def test_a_finished_run_is_not_done_again_and_another_failure_is_told(runs, tmp_path, tried):
    (tmp_path / "ppo.py").write_text("raise SystemExit(3)")
    make_run(runs / "ppo-1" / "full", TRAINING, [True])
    train("ppo", tmp_path, runs, seeds=[0, 1])
    assert tried == [runs / "ppo-0"]
    with pytest.raises(WorkerError, match="exit status 3"):
        train("ppo", tmp_path, runs, seeds=[2])
    with pytest.raises(UnknownNameError, match="ppo"):
        train("pop", tmp_path, runs)


def test_the_file_keeps_what_other_runs_left_in_it(runs, tmp_path):
    (tmp_path / "ppo.py").write_text("raise SystemExit('nothing is trained here')")
    make_run(runs / "ppo-2", replace(TRAINING, seed=2), [True])
    path = tmp_path / "baselines.json"
    path.write_text(json.dumps({"runs": {"sac-0": {"method": "sac"}}}))
    main([str(tmp_path), str(runs), str(path), "ppo"])
    assert list(json.loads(path.read_text())["runs"]) == ["ppo-0", "ppo-1", "ppo-2", "residual-0/base", "sac-0"]


def test_curves_are_drawn(runs, tmp_path):
    draw_curves(collected(runs), tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InvalidValueError, match="learns"):
        draw_curves({}, tmp_path / "none.png")


@pytest.mark.slow  # an episode of 10 s
def test_a_policy_is_tried_in_full_on_the_seeds_of_its_evaluation(tmp_path, monkeypatch):
    monkeypatch.undo()
    env = gym.make("laploop:laploop/Reach-v1", fidelity="fast")
    save_sb3(PPO("MlpPolicy", env, policy_kwargs={"net_arch": [8]}), tmp_path, {"net_arch": [8]})
    env.close()
    write_result(tmp_path, replace(TRAINING, keywords={"fidelity": "fast"}), [SCORE])
    baselines.try_in_full(tmp_path)
    tried = json.loads((tmp_path / "full" / "summary.json").read_text())
    assert (tried["method"], tried["keywords"], tried["steps"]) == ("ppo, in full", {"fidelity": "full"}, 0)
    assert [row["seed"] for row in tried["rows"]] == [UNSEEN_SEED]
