import json
from pathlib import Path

import pytest

from laploop.envs.tasks.configs import ReachConfig
from laploop.studies.learners import returns

ROOT = Path(__file__).parents[3]


def test_what_is_measured_joins_what_the_file_has_of_other_tasks(tmp_path, monkeypatch):
    monkeypatch.setattr(returns, "measure_returns", lambda task: f"{task}, measured now")
    path = tmp_path / "returns.json"
    path.write_text(json.dumps({"tasks": {"look": "measured before", "reach": "measured before"}}))
    returns.main([str(path), "reach"])
    assert json.loads(path.read_text())["tasks"] == {"reach": "reach, measured now", "look": "measured before"}


def test_each_policy_plays_its_episodes(monkeypatch):
    # Three steps an episode.
    monkeypatch.setattr(returns, "CONDITIONS", {"perception": "oracle", "config": ReachConfig(max_seconds=0.16)})
    row = returns.measure_returns("reach", seeds=2)
    assert row["zero"]["steps"] == [3, 3]
    # Half of the episode's cost of time for three of four steps.
    assert row["zero"]["mean_return"] == pytest.approx(-0.5 * 0.12 / 0.16, abs=1e-3)
    assert row["scripted"]["mean_return"] > row["zero"]["mean_return"]
    assert row["random"]["success_rate"] == 0.0


def test_the_page_of_the_tasks_has_the_measured_table():
    tasks = json.loads((ROOT / "docs" / "results" / "learner-returns.json").read_text())["tasks"]
    assert returns.returns_table(tasks) in (ROOT / "docs" / "tasks" / "README.md").read_text()
