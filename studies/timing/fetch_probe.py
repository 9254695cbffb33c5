"""Measures Gymnasium-Robotics' Fetch on request: a script for an environment of its own, which knows nothing of this project.

A step of Fetch is 20 physics steps of 2 ms: 40 ms of simulated time, as a period of the stripe camera. Same protocol as
`probe.py`; where no OpenGL can be had, it measures without the picture and says so in its greeting.
"""

import ctypes
import json
import os
import sys
import time
import warnings
from typing import Any

import numpy as np

_SIZE = 256
"""Width and height of the picture, as the stripe camera's."""


class Fetch:
    """The reaching task, its arm on a slow circle, with a picture each step."""

    def __init__(self) -> None:
        """Make it, and find out whether it can be seen."""
        self.why_not = ""
        """Why there is no picture; empty where there is one."""
        try:
            self._env = _environment(render_mode="rgb_array", width=_SIZE, height=_SIZE)
            self._env.render()
        except Exception as error:  # noqa: BLE001  whatever a missing driver raises
            self.why_not = f"{type(error).__name__}: {error}".splitlines()[0]
            os.environ["MUJOCO_GL"] = "disabled"
            self._env = _environment()
        self._steps = 0

    def block(self, count: int) -> dict[str, float]:
        """Measure `count` steps."""
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(count):
            angle = 2.0 * np.pi * self._steps / 100.0
            self._env.step(np.array([0.2 * np.cos(angle), 0.2 * np.sin(angle), 0.0, 0.0], dtype=np.float32))
            if not self.why_not:
                self._env.render()
            self._steps += 1
        wall_s, cpu_s = time.perf_counter() - wall, time.process_time() - cpu
        return {"units": count, "wall_s": wall_s, "cpu_s": cpu_s}

    def about(self) -> dict[str, Any]:
        """Return what is measured."""
        from importlib.metadata import version

        step_ms = 1e3 * self._env.model.opt.timestep * self._env.n_substeps
        picture = None if self.why_not else [_SIZE, _SIZE]
        about = {"environment": self._env.spec.id, "step_ms": step_ms, "picture": picture, "why_not": self.why_not}
        return about | {name: version(name) for name in ("gymnasium-robotics", "mujoco")}


def _environment(**options: Any) -> Any:
    """Make the newest Fetch that there is, without a limit of time."""
    import gymnasium
    import gymnasium_robotics  # type: ignore[import-not-found]

    gymnasium.register_envs(gymnasium_robotics)
    found = [name for name in gymnasium.registry if name.startswith("FetchReach-v")]
    newest = max(found, key=lambda name: int(name.rpartition("v")[2]))
    environment = gymnasium.make(newest, max_episode_steps=10**9, **options).unwrapped
    environment.reset(seed=0)
    return environment


def _main() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, 9)  # killed when its parent ends
    protocol = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    warnings.simplefilter("ignore")
    fetch = Fetch()
    count = 0
    print(json.dumps(fetch.about()), file=protocol, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        if "measure" in request:
            count = request["options"]["count"]
            answer: dict[str, Any] = {}
        else:
            answer = fetch.block(count)
        print(json.dumps(answer), file=protocol, flush=True)


if __name__ == "__main__":
    _main()
