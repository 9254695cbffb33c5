"""The comparison with Fetch, on an environment that stands in for it."""

import sys
from types import ModuleType, SimpleNamespace

import gymnasium
import numpy as np
import pytest

from laploop.studies.timing.fetch_comparison import compare_with_fetch, fetch_sentence
from laploop.studies.timing.fetch_probe import Fetch


class Robot(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012  Gymnasium's own convention
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (4,))
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    n_substeps = 20
    sees = True

    def __init__(self, render_mode=None, width=0, height=0):
        self.render_mode, self.pictures, self.actions = render_mode, 0, []
        self.model = SimpleNamespace(opt=SimpleNamespace(timestep=0.002))

    def reset(self, *, seed=None, options=None):
        return np.zeros(1, dtype=np.float32), {}

    def step(self, action):
        self.actions.append(action)
        return np.zeros(1, dtype=np.float32), 0.0, False, False, {}

    def render(self):
        if not self.sees:
            raise RuntimeError("no OpenGL\nat all")
        self.pictures += 1


@pytest.fixture
def robot(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnasium_robotics", ModuleType("gymnasium_robotics"))
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"{name} 1.0")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    for number in (2, 10):
        gymnasium.register(f"FetchReach-v{number}", entry_point=Robot)
    yield Robot
    for number in (2, 10):
        del gymnasium.registry[f"FetchReach-v{number}"]


def test_fetch_steps_in_a_circle_and_takes_a_picture_each_time(robot):
    fetch = Fetch()
    sample = fetch.block(5)
    assert sample["units"] == 5
    assert (len(fetch._env.actions), fetch._env.pictures) == (5, 6)
    assert all(robot.action_space.contains(action) for action in fetch._env.actions)
    about = fetch.about()
    assert (about["environment"], about["step_ms"], about["picture"]) == ("FetchReach-v10", pytest.approx(40.0), [256, 256])


def test_without_opengl_it_is_measured_without_its_picture_which_is_said(robot, monkeypatch):
    monkeypatch.setattr(robot, "sees", False)
    fetch = Fetch()
    fetch.block(1)
    assert len(fetch._env.actions) == 1
    about = fetch.about()
    assert (about["picture"], about["why_not"]) == (None, "RuntimeError: no OpenGL")


class Probe:
    """Takes so much CPU time a step."""

    def __init__(self, cpu_s, greeting=None):
        self.cpu_s, self.greeting, self.prepared = cpu_s, greeting, None

    def prepare(self, measure, options):
        self.prepared = (measure, options)
        return {}

    def block(self, number):
        return {"units": 2, "wall_s": 9.0, "cpu_s": 2 * self.cpu_s}


def test_ratios_are_of_cpu_time_and_the_sentence_tells_them():
    greeting = {"environment": "FetchReach-v4", "step_ms": 40.0, "picture": [256, 256], "why_not": ""}
    fetch, fast, full = Probe(0.02, greeting), Probe(0.01), Probe(0.03)
    result = compare_with_fetch(fetch, (fast, full), seed=3, steps=2, rounds=3)
    assert fast.prepared == ("steps", {"fidelity": "fast", "observation": "state", "seed": 3, "count": 2})
    assert full.prepared[1]["observation"] == "depth_oracle"
    assert result["fetch"]["cpu_ms"]["median"] == pytest.approx(20.0)
    assert result["fast"]["state"]["ratio"]["median"] == pytest.approx(0.5)
    assert result["full"]["depth_oracle"]["ratio"]["median"] == pytest.approx(1.5)
    assert fetch_sentence(result) == (
        "CPU time of 40 ms of the world: FetchReach-v4 with a picture of 256 x 256 20 ms; "
        "`fast`, `state` 10 ms, 0.50 of it (0.50 to 0.50); `full`, `depth_oracle` 30 ms, 1.50 of it (1.50 to 1.50)."
    )
    result["fetch"] |= {"picture": None, "why_not": "no OpenGL"}
    assert "FetchReach-v4 without its picture (no OpenGL) 20 ms" in fetch_sentence(result)
