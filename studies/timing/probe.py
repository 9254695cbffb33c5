"""Measures parts of the loop on request: the script of a process of its own, for this checkout of the project or another.

Whichever checkout comes first on the module path is measured. It may be older than this script, which therefore asks for
whatever came later, and otherwise keeps to what has always been there.

Protocol: a line of JSON in, a line of JSON out. `{"measure": NAME, "options": {...}}` prepares a measurement and answers with
the fidelity that it runs at; each `{"block": NUMBER}` measures once and answers with `units` of work, the `wall_s` and the
`cpu_s` (of all threads) that they took, and whatever else was measured.
"""

import ctypes
import inspect
import itertools
import json
import math
import multiprocessing
import os
import resource
import sys
import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from gymnasium.vector import SyncVectorEnv

import laploop
from laploop.assets.shafts import INSTRUMENT
from laploop.envs.episode import run_episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.tasks.configs import ReachConfig
from laploop.envs.tasks.reach import ReachEnv
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.geometry import Rig

try:
    from laploop.envs.fidelity import with_fidelity
except ModuleNotFoundError:
    with_fidelity = None  # type: ignore[assignment]  # an older checkout knows `full` alone


FRAME_NS = 40_000_000
"""What counts as one step of the environment, in simulated time: a period of the camera."""

OBSERVATIONS = {
    "state": ("state", "oracle"),
    "stripes": ("stripes", "oracle"),
    "depth_oracle": ("depth", "oracle"),
    "depth_compact": ("depth", "compact"),
}
"""Observation mode and estimator of what is measured."""

_CIRCLE_M, _CIRCLE_S = 0.004, 4.0
"""Radius and period of the tip's slow circle above the tissue."""
_TICKS = 5
"""Control periods in such a step."""
_HOVER_M, _PRESS_N, _FORCE_SEEN_TICKS = 0.008, 0.3, 2000
_ENDLESS_S = 3600.0

Sample = dict[str, Any]


class Measure(ABC):
    """Something prepared that can be measured again and again."""

    _env: Any = None
    """The environment that it measures, if it does."""

    @abstractmethod
    def block(self, number: int, /) -> Sample:
        """Measure once."""

    def close(self) -> None:
        """End the environment's threads and processes."""
        if self._env is not None:
            self._env.close()


def _took(work: Callable[[], object], units: float) -> Sample:
    cpu, wall = time.process_time(), time.perf_counter()
    work()
    return {"units": units, "wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}


def _reach(fidelity: str, **changes: Any) -> ReachConfig:
    """Return a reach that does not end by itself."""
    config = ReachConfig(max_seconds=_ENDLESS_S, success_hold_s=_ENDLESS_S, **changes)
    return config if with_fidelity is None else with_fidelity(config, fidelity)


def make_vector(fidelity: str, observation: str, environments: int) -> tuple[Any, int, float]:
    """Return a vector for learners, its steps a camera period, and the speed in m/s that an action of 1 stands for.

    An older checkout has Gymnasium's vector of what `Steps` measures.
    """
    try:
        from laploop.envs.batch.making import make_learner_vector
    except ModuleNotFoundError:
        return SyncVectorEnv([lambda: _environment(fidelity, observation)] * environments), _TICKS, 1.0
    mode, perception = OBSERVATIONS[observation]
    config = _reach(fidelity)
    vector = make_learner_vector(num_envs=environments, task="reach", config=config, observation=mode, perception=perception)
    return vector, 1, config.max_tip_speed_mps


def _on_circle(now_ns: int) -> Any:
    """Return the action at a time that moves the tip on its circle."""
    angle, speed = math.tau * now_ns * 1e-9 / _CIRCLE_S, math.tau * _CIRCLE_M / _CIRCLE_S
    return np.array([speed * math.cos(angle), speed * math.sin(angle), 0.0], dtype=np.float32)


def _held_mb() -> float:
    """Return what this process and those that it started hold, what they share counted once."""
    mine = [os.getpid(), *(process.pid for process in multiprocessing.active_children())]
    lines = [line for pid in mine for line in Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="utf-8").splitlines()]
    return sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1.024e-3


def _environment(fidelity: str, observation: str) -> ReachEnv:
    mode, perception = OBSERVATIONS[observation]
    return ReachEnv(_reach(fidelity, observation_mode=mode), perception=perception)


class Steps(Measure):
    """Steps of the environment while the tip moves on a slow circle above the tissue."""

    def __init__(self, *, fidelity: str, observation: str, seed: int, count: int) -> None:
        self._env = _environment(fidelity, observation)
        self._env.reset(seed=seed)
        self._count = count
        timer: Any = self._env.loop.timer
        self._laps: dict[str, float] = defaultdict(float)
        self._background: dict[str, float] = defaultdict(float)
        self._ask_laps = timer.lap_ms
        # Recorders ask for laps as well, after which they are forgotten; what other threads add is no part of a step's time.
        vars(timer).update(lap_ms=self._lap, add=self._add)

    def block(self, _number: int, /) -> Sample:
        """Measure some steps; `stage_ms` adds up to the wall time of one, `background_ms` passes beside it."""
        self._lap()
        self._laps.clear()
        self._background.clear()
        sample = _took(self._run, self._count)
        self._lap()
        stages, background = (
            {stage: total / self._count for stage, total in spent.items()} for spent in (self._laps, self._background)
        )
        stages["other"] = 1e3 * sample["wall_s"] / self._count - sum(stages.values())
        return sample | {"stage_ms": stages, "background_ms": background}

    def _lap(self) -> dict[str, float]:
        lap: dict[str, float] = self._ask_laps()
        for stage, spent_ms in lap.items():
            self._laps[stage] += spent_ms
        return lap

    def _add(self, stage: str, seconds: float) -> None:
        self._background[stage] += 1e3 * seconds

    def _run(self) -> None:
        loop = self._env.loop
        end_ns = loop.now_ns + self._count * FRAME_NS
        while loop.now_ns < end_ns:
            _, _, terminated, truncated, info = self._env.step(_on_circle(loop.now_ns))
            if terminated or truncated:
                raise RuntimeError(f"the tip's circle ended with {info['terminated_by']}; choose another seed")


class VectorSteps(Measure):
    """The same of many environments for learners at once, a decision a camera period."""

    def __init__(self, *, fidelity: str, observation: str, seed: int, environments: int, count: int) -> None:
        self._env, self._decisions, self._scale_mps = make_vector(fidelity, observation, environments)
        self._shape, self._count, self._done = (environments, 3), count, 0
        self._env.reset(seed=seed)

    def block(self, _number: int, /) -> Sample:
        """Measure some steps of all; CPU time is that of this process alone."""
        return _took(self._run, self._count * self._shape[0])

    def _run(self) -> None:
        for _ in range(self._count * self._decisions):
            action = _on_circle(self._done * FRAME_NS // self._decisions) / np.float32(self._scale_mps)
            self._env.step(np.broadcast_to(action, self._shape))
            self._done += 1


class VectorMemory(Measure):
    """Memory that each further environment of a vector takes, which observes `state`; for a process that did nothing else."""

    def __init__(self, *, fidelity: str, seed: int, fewest: int, most: int) -> None:
        self._options: dict[str, Any] = {"fidelity": fidelity, "observation": "state", "seed": seed, "count": 1}
        self._counts = fewest, most

    def block(self, number: int, /) -> Sample:
        """Return `each_mb`, from vectors of two sizes, with all their processes."""
        held = []
        for count in self._counts:
            steps = VectorSteps(**self._options, environments=count)
            sample = steps.block(number)
            held.append(_held_mb())
            steps.close()
        fewest, most = self._counts
        return sample | {"each_mb": (held[1] - held[0]) / (most - fewest)}


class Physics(Measure):
    """Physics with all that goes with it: the loop between two frames, without the arm's controller."""

    _COUNT = 20

    def __init__(self, *, fidelity: str, pressing: bool, seed: int) -> None:
        config = _reach(fidelity, observation_mode="state")
        # A frame a second leaves most of it to physics alone.
        self._env = ReachEnv(replace(config, loop=replace(config.loop, camera_hz=1.0)), perception="oracle")
        observation, _ = self._env.reset(seed=seed)
        if pressing:
            self._press(observation)

    def block(self, _number: int, /) -> Sample:
        """Measure `_COUNT` camera periods of physics between two frames."""
        loop = self._env.loop
        room_ns = (self._COUNT + 1) * FRAME_NS
        while not FRAME_NS < loop.now_ns % loop.config.camera_ns < loop.config.camera_ns - room_ns:
            loop.advance(np.zeros(3))
        loop.timer.lap_ms()
        force, ticks = 0.0, self._COUNT * FRAME_NS // loop.config.control_ns

        def run() -> None:
            nonlocal force
            for _ in range(ticks):
                loop.advance(np.zeros(3))
                force += loop.mean_force_n / ticks

        sample = _took(run, self._COUNT)
        control_s = 1e-3 * loop.timer.lap_ms().get("control", 0.0)
        return sample | {name: sample[name] - control_s for name in ("wall_s", "cpu_s")} | {"force_n": force}

    def _press(self, seen: dict[str, Any]) -> None:
        """Bring the tip over the target, then down until the tissue pushes back."""
        above = False
        for _ in range(_FORCE_SEEN_TICKS):
            normal = seen["target_normal"]
            off = seen["target_position"] + (INSTRUMENT.tip_radius_m + _HOVER_M) * normal - seen["tip_position"]
            across = off - (off @ normal) * normal
            above = above or float(np.linalg.norm(off)) < 0.0005
            action = 4.0 * across - 0.006 * normal if above else 4.0 * off
            seen, *_ = self._env.step(np.clip(action, -0.03, 0.03).astype(np.float32))
            if float(np.linalg.norm(seen["contact_force"])) > _PRESS_N:
                return
        raise RuntimeError(f"the tip did not press on the tissue with {_PRESS_N} N; choose another seed")


class PhysicsSteps(Measure):
    """Steps of the theatre alone, its arms at home."""

    _COUNT = 10

    def __init__(self, *, fidelity: str, seed: int) -> None:
        loop = _reach(fidelity).loop
        self._theatre = Theatre(loop.theatre, loop, seed=seed)
        self._steps = self._COUNT * FRAME_NS // loop.physics_ns

    def block(self, _number: int, /) -> Sample:
        """Measure `_COUNT` camera periods of physics."""

        def run() -> None:
            for _ in range(self._steps):
                self._theatre.step()

        return _took(run, self._COUNT)


class Captures(Measure):
    """Pictures of the stripe camera, on one thread, physics going on in between."""

    _COUNT = 10

    def __init__(self, *, fidelity: str, seed: int) -> None:
        loop = _reach(fidelity).loop
        self._theatre = Theatre(loop.theatre, loop, seed=seed)
        self._steps = FRAME_NS // loop.physics_ns
        self._camera = StripeCamera(Rig.from_optics(loop.theatre.scope), loop.optics, device=loop.device, threads=1)
        attach: Any = self._camera.attach
        surface = {"tissue": self._theatre.tissue} if "tissue" in inspect.signature(attach).parameters else {}
        attach(self._theatre.model, appearance=loop.theatre.tissue.appearance, rng=np.random.default_rng(seed), **surface)
        self._rng = np.random.default_rng(seed)

    def block(self, _number: int, /) -> Sample:
        """Measure `_COUNT` pictures."""
        total = {"units": float(self._COUNT), "wall_s": 0.0, "cpu_s": 0.0}
        for _ in range(self._COUNT):
            for _ in range(self._steps):
                self._theatre.step()
            self._theatre.refresh()
            seen = self._theatre.data, self._theatre.world_from_camera(), self._rng
            one = _took(partial(self._camera.capture, *seen), 1)
            total |= {name: total[name] + one[name] for name in ("wall_s", "cpu_s")}
        return total


class Resets(Measure):
    """Resets of the environment, each block one: to a seed not seen before, or to one that was."""

    _fresh = itertools.count(1_000_000)
    """Seeds that no other measurement of this process uses, whose scenes may be kept."""

    def __init__(self, *, fidelity: str, observation: str, new: bool, seed: int) -> None:
        self._env = _environment(fidelity, observation)
        self._seed, self._new = seed, new
        self._env.reset(seed=seed)

    def block(self, _number: int, /) -> Sample:
        """Measure a reset."""
        seed = next(self._fresh) if self._new else self._seed
        return _took(lambda: self._env.reset(seed=seed), 1)


class Episodes(Measure):
    """Whole episodes with the scripted controller; the factor of real time leaves the reset out."""

    def __init__(self, *, fidelity: str, perception: str, seed: int, seconds: float) -> None:
        episode = EpisodeConfig.of(perception=perception, seed=seed, seconds=seconds)
        self._episode = episode if with_fidelity is None else replace(episode, task=with_fidelity(episode.task, fidelity))

    def block(self, number: int, /) -> Sample:
        """Measure an episode; its `summary` comes with it."""
        episode = replace(self._episode, seed=self._episode.seed + number)
        cpu = time.process_time()
        summary = run_episode(episode)
        cpu_s = time.process_time() - cpu
        factor = summary["real_time_factor"]
        return {"units": factor, "wall_s": 1.0, "cpu_s": cpu_s, "summary": {"seed": episode.seed, **summary}}


class Memory(Measure):
    """Memory of this process after a second of one environment; for a process that did nothing else."""

    def __init__(self, *, fidelity: str, observation: str, seed: int) -> None:
        self._steps = Steps(fidelity=fidelity, observation=observation, seed=seed, count=25)

    def block(self, number: int, /) -> Sample:
        """Return `peak_mb` and `resident_mb` after a second of simulated time."""
        sample = self._steps.block(number)
        status = Path("/proc/self/status")
        found = dict.fromkeys(("VmHWM", "VmRSS"), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
        if status.is_file():
            lines = (line.split() for line in status.read_text(encoding="utf-8").splitlines())
            found |= {words[0][:-1]: int(words[1]) for words in lines if words[0][:-1] in found}
        return sample | {"peak_mb": found["VmHWM"] * 1.024e-3, "resident_mb": found["VmRSS"] * 1.024e-3}

    def close(self) -> None:
        """End the loop's threads."""
        self._steps.close()


MEASURES: dict[str, Callable[..., Measure]] = {
    "steps": Steps,
    "vector steps": VectorSteps,
    "vector memory": VectorMemory,
    "physics": Physics,
    "physics steps": PhysicsSteps,
    "captures": Captures,
    "resets": Resets,
    "episodes": Episodes,
    "memory": Memory,
}


def serve(requests: TextIO, answers: TextIO) -> None:
    """Answer until there are no more requests."""
    current: Measure | None = None
    print(json.dumps({"source": str(Path(laploop.__file__).parent)}), file=answers, flush=True)
    for line in requests:
        request = json.loads(line)
        if "measure" in request:
            if current is not None:
                current.close()
            current = MEASURES[request["measure"]](**request["options"])
            answer: Sample = {"fidelity": "full" if with_fidelity is None else request["options"].get("fidelity")}
        elif current is not None:
            answer = current.block(request["block"])
        print(json.dumps(answer), file=answers, flush=True)
    if current is not None:
        current.close()


if __name__ == "__main__":
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, 9)  # killed when its parent ends
    # Libraries greet on the standard output, which is the protocol's here.
    protocol = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    serve(sys.stdin, protocol)
