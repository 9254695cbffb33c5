"""What a probe measures, in this process: the protocol is tested with the processes."""

import io
import json

import numpy as np
import pytest

from laploop.envs.batch import vector_env
from laploop.studies.timing import probe
from laploop.studies.timing.probe import Captures, Memory, Physics, PhysicsSteps, Resets, Steps, VectorSteps, serve


@pytest.fixture
def measuring():
    made = []

    def make(kind, **options):
        made.append(kind(**{"seed": 0, "fidelity": "full", **options}))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_stages_of_a_step_add_up_to_its_time(measuring):
    steps = measuring(Steps, observation="state", count=2)
    loop = steps._env.loop
    began_ns = loop.now_ns
    sample = steps.block(0)
    assert loop.now_ns - began_ns == 2 * 40_000_000
    assert sample["units"] == 2
    assert sum(sample["stage_ms"].values()) == pytest.approx(1e3 * sample["wall_s"] / 2)
    assert sample["stage_ms"]["physics"] > 0.0
    # What is left over is not what was counted twice.
    assert 0.0 < sample["stage_ms"]["other"] < 0.9 * 1e3 * sample["wall_s"] / 2


def test_a_vectors_steps_are_those_of_all_its_environments(measuring, monkeypatch):
    monkeypatch.setattr(vector_env, "usable_cores", lambda: 1)
    vector = measuring(VectorSteps, fidelity="fast", observation="state", environments=3, count=2)
    task = vector._env.call("task_env")[2]
    began_ns = task.loop.now_ns
    assert vector.block(0)["units"] == 6
    assert task.loop.now_ns - began_ns == 2 * 40_000_000
    speed = np.linalg.norm(task.loop.reading().tip_velocity_in_world)
    assert speed == pytest.approx(2.0 * np.pi * 0.004 / 4.0, rel=0.5)


def test_what_other_threads_do_is_told_apart(measuring):
    steps = measuring(Steps, observation="stripes", count=2)
    sample = steps.block(0)
    assert sample["background_ms"]["render"] > 0.0
    assert sum(sample["stage_ms"].values()) == pytest.approx(1e3 * sample["wall_s"] / 2)
    assert min(sample["stage_ms"].values()) >= 0.0


def test_the_tip_circles_above_the_tissue_and_comes_back(measuring):
    steps = measuring(Steps, observation="state", count=50)
    theatre = steps._env.loop.theatre
    begin, far, force = theatre.tip_in_world(), 0.0, 0.0
    for number in range(2):
        steps.block(number)
        far = max(far, float(np.linalg.norm(theatre.tip_in_world() - begin)))
        force = max(force, steps._env.loop.max_force_n)
    # A circle of 4 mm radius: half round after 2 s, back after 4.
    assert far == pytest.approx(0.008, abs=0.0005)
    assert np.linalg.norm(theatre.tip_in_world() - begin) < 0.0005
    assert force == 0.0


def test_no_frame_falls_into_the_time_of_physics_and_pressing_presses(measuring, monkeypatch):
    monkeypatch.setattr(Physics, "_COUNT", 3)
    for pressing in (False, True):
        physics = measuring(Physics, pressing=pressing)
        loop = physics._env.loop
        for number in range(2):
            sample = physics.block(number)
            assert loop.now_ns % loop.config.camera_ns > 4 * 40_000_000
            assert (sample["force_n"] > 0.1) == pressing
            assert sample["cpu_s"] > 0.0


def test_fast_takes_half_the_steps_of_physics(measuring):
    full, fast = (measuring(PhysicsSteps, fidelity=name) for name in ("full", "fast"))
    assert full._steps == 2 * fast._steps == PhysicsSteps._COUNT * 20


def test_a_checkout_that_knows_no_fidelity_runs_at_full_and_says_so(monkeypatch):
    monkeypatch.setattr(probe, "with_fidelity", None)
    requests = io.StringIO('{"measure": "physics steps", "options": {"fidelity": "fast", "seed": 0}}\n{"block": 0}\n')
    answers = io.StringIO()
    serve(requests, answers)
    greeting, prepared, sample = map(json.loads, answers.getvalue().splitlines())
    assert greeting["source"].endswith("laploop")
    assert prepared == {"fidelity": "full"}
    assert sample["units"] == 10
    assert sample["wall_s"] > 0.0


def seeds_of(resets):
    """Return the seeds of two blocks of resets."""
    asked, original = [], resets._env.reset
    resets._env.reset = lambda *, seed: (asked.append(seed), original(seed=seed))
    assert [resets.block(number)["units"] for number in range(2)] == [1, 1]
    return asked


def test_resets_take_a_seed_that_nothing_else_has_used_or_always_the_same(measuring):
    first, second = (seeds_of(measuring(Resets, observation="state", new=True, seed=5)) for _ in range(2))
    assert len({5, *first, *second}) == 5
    assert seeds_of(measuring(Resets, observation="state", new=False, seed=5)) == [5, 5]


def test_pictures_are_counted_without_the_physics_between_them(measuring, monkeypatch):
    monkeypatch.setattr(Captures, "_COUNT", 2)
    captures = measuring(Captures)
    before_ns = captures._theatre.now_ns
    sample = captures.block(0)
    assert captures._theatre.now_ns - before_ns == 2 * 40_000_000
    assert (sample["units"], sample["wall_s"] > 0.0) == (2, True)


def test_memory_at_its_peak_is_no_less_than_what_is_resident(measuring):
    sample = measuring(Memory, observation="state").block(0)
    assert 50.0 < sample["resident_mb"] <= sample["peak_mb"] < 1e5
