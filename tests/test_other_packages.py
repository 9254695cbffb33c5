"""What another package adds: an estimator, a controller, a predictor and a task, each with one entry."""

import json
import os
import subprocess
import sys

import gymnasium as gym
import pytest

from laploop.cli.main import main
from laploop.control.controllers.registry import CONTROLLERS
from laploop.control.prediction.registry import PREDICTORS
from laploop.envs.episode import run_episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.tasks.registry import TASKS, environment_id, make_environment
from laploop.errors import InvalidValueError
from laploop.perception.estimators.registry import ESTIMATORS

MODULE = '''
from typing import Annotated, ClassVar

import numpy as np

from laploop.configuration import Field, configuration
from laploop.control import HeldMeasurement
from laploop.envs import Criterion, TaskConfig, TaskEnv, TaskSpec
from laploop.perception import DepthEstimate


class Flat:
    """Sees a plane."""

    def __init__(self, rig, depth_mm=90.0):
        self.depth_mm = depth_mm

    def estimate(self, image):
        return DepthEstimate(depth_mm=np.full(image.shape, self.depth_mm, np.float32), valid=np.ones(image.shape, bool))


class Downwards:
    """Goes away from the camera."""

    def __init__(self, rig, speed_mps=0.01, predictor=None):
        self.speed_mps = speed_mps

    def reset(self):
        pass

    def command(self, state):
        return np.array([0.0, 0.0, self.speed_mps])


class Held(HeldMeasurement):
    """Holds what was measured last."""


@configuration
class PokeConfig(TaskConfig):
    """Go down."""

    kind: str = "poke"
    way_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.001
    """How far."""


class PokeEnv(TaskEnv[PokeConfig]):
    """Go down by some way."""

    config_type: ClassVar[type[PokeConfig]] = PokeConfig

    def target_error_mm(self):
        return self.touch_error_mm()

    def measure(self, *, begin):
        tip_z_m = float(self.loop.theatre.tip_in_world()[2])
        self.start_z_m = tip_z_m if begin else self.start_z_m
        self.gone_m = self.start_z_m - tip_z_m

    def ended_by(self):
        return "success" if self.gone_m >= self.config.way_m else None

    def reward_terms(self):
        return {"distance": 1e3 * self.gone_m}

    def task_info(self):
        return {"target_error_mm": self.target_error_mm()}

    def metrics(self):
        return {"gone_mm": 1e3 * self.gone_m}


NARROW = TaskSpec(
    environment="laploop.envs.tasks.reach:ReachEnv", config="laploop.envs.tasks.configs:ReachConfig", controller="reach"
)
POKE = TaskSpec(
    environment="stranger:PokeEnv",
    config="stranger:PokeConfig",
    controller="stranger:Downwards",
    criteria=(Criterion(name="gone", column="gone_mm", unit="mm", statistic="min", at_least=1.0),),
)
'''

ENTRY_POINTS = """
[laploop.estimators]
flat = stranger:Flat
[laploop.controllers]
downwards = stranger:Downwards
[laploop.predictors]
held = stranger:Held
[laploop.tasks]
poke = stranger:POKE
"""

NAMES = {"flat": "flat", "downwards": "downwards", "held": "held", "poke": "poke"}
PATHS = {"flat": "stranger:Flat", "downwards": "stranger:Downwards", "held": "stranger:Held", "poke": "stranger:POKE"}


@pytest.fixture
def stranger(tmp_path, monkeypatch):
    """Install a package that laploop knows nothing of."""
    folder = tmp_path / "site"
    info = folder / "stranger-1.dist-info"
    info.mkdir(parents=True)
    (folder / "stranger.py").write_text(MODULE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(folder)
    yield folder
    sys.modules.pop("stranger", None)


def test_its_entries_are_listed_with_the_built_in_ones(stranger):
    for registry, name in ((ESTIMATORS, "flat"), (CONTROLLERS, "downwards"), (PREDICTORS, "held"), (TASKS, "poke")):
        assert name in registry.names()


@pytest.mark.parametrize("called", [NAMES, PATHS], ids=["by name", "by module:Class"])
def test_it_takes_part_in_an_episode_from_python(stranger, called):
    episode = EpisodeConfig.of(perception=called["flat"], controller=called["downwards"], seconds=0.1)
    summary = run_episode(episode)
    assert summary["perception"] == called["flat"]
    assert summary["depth_mae_mm"] > 1.0
    run_episode(EpisodeConfig.of(task="track", perception="oracle", prediction=called["held"], seconds=0.06))
    poked = run_episode(EpisodeConfig.of(task=called["poke"], perception="oracle", seconds=1.0))
    # 10 mm/s over 1 mm, and the start's acceleration.
    assert (poked["task"], poked["success"], poked["terminated_by"]) == (called["poke"], True, "success")
    assert poked["metrics"]["gone_mm"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("called", [NAMES, PATHS], ids=["by name", "by module:Class"])
def test_it_takes_part_from_the_command_line_and_from_a_file(stranger, tmp_path, capsys, called):
    out, again = tmp_path / "out", tmp_path / "again"
    names = ["--task", called["poke"], "--perception", called["flat"], "--controller", called["downwards"]]
    fields = ["--way-m", "0.002", "--perception.arguments.depth-mm", "80", "--controller.arguments.speed_mps", "0.02"]
    arguments = ["run", *names, "--prediction", called["held"], *fields, "--no-rerun", "--out", str(out)]
    assert main(arguments) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["task"], summary["success"]) == (called["poke"], True)
    assert summary["metrics"]["gone_mm"] == pytest.approx(2.0, abs=0.2)
    assert summary["config"]["perception"]["arguments"] == {"depth_mm": 80}
    repeat = ["run", "--config", str(out / "summary.json"), "--no-rerun", "--out", str(again)]
    if called is PATHS:
        assert main(repeat) == 2
        error = capsys.readouterr().err
        assert "summary.json: perception.name is 'stranger:Flat'; allowed: no module:Class from a file without --trust" in error
        repeat.append("--trust")
    assert main(repeat) == 0
    assert json.loads((again / "summary.json").read_text())["metrics"] == summary["metrics"]


def test_its_task_has_an_id_and_a_campaign(stranger, tmp_path):
    code = "import laploop, gymnasium; print(*(gymnasium.spec(f'laploop/Poke-v{version}').kwargs for version in (0, 1)))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(stranger), *filter(None, sys.path)])}
    shown = subprocess.run(  # noqa: S603
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True, env=environment
    ).stdout
    assert shown.strip() == "{'task': 'poke'} {'task': 'poke'}"
    assert environment_id("poke") == "laploop/Poke-v0"
    made = make_environment("poke", perception="oracle")
    assert made.unwrapped.task == "poke"
    assert isinstance(made, gym.Env)
    out = tmp_path / "tasks"
    assert main(["tasks", "--only", "poke", "--seeds", "1", "--perception.name", "oracle", "--out", str(out)]) == 0
    (line,) = json.loads((out / "summary.json").read_text())["campaigns"]
    assert (line["campaign"], line["met"]) == ("poke", True)
    assert line["checks"][0]["name"] == "gone"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"perception": "stranger:MODULE"}, "estimator"),
        ({"perception": "stranger:Held"}, "estimator"),
        ({"controller": "stranger:Flat"}, "controller"),
        ({"prediction": "stranger:Flat", "task": "track"}, "prediction"),
        ({"task": "stranger:Flat"}, "task is 'stranger:Flat'; allowed: the name of a TaskSpec"),
        ({"task": "stranger:NARROW"}, "task is 'stranger:NARROW'; allowed: a task whose ReachConfig has a field `kind: str`"),
        ({"perception": "no_such_module:X"}, "ModuleNotFoundError"),
    ],
)
def test_something_else_in_its_place_is_refused(stranger, options, message):
    with pytest.raises(InvalidValueError, match=message) as caught:
        run_episode(EpisodeConfig.of(**{"seconds": 0.05, **options}))
    assert "\n" not in str(caught.value)
