"""Mutations of core behaviour: each breaks one promise in a copy of the tree, and the tests named with it must notice."""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
COPIED = ("assets", "cli", "control", "envs", "perception", "src", "studies", "tests", "pyproject.toml")


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """A change of one place in the code that stands for a mistake somebody could make."""

    name: str
    file: str
    before: str
    """Text that the file holds exactly once."""
    after: str
    tests: tuple[str, ...]
    """Files or single tests, of which at least one must fail."""


MUTATIONS = (
    Mutation(
        name="baseline-sign",
        file="perception/geometry.py",
        before="self.camera.rays[..., 0] - self.baseline_m / depth_m",
        after="self.camera.rays[..., 0] + self.baseline_m / depth_m",
        tests=("tests/perception/test_geometry.py",),
    ),
    Mutation(
        name="baseline-sign-of-the-scope",
        file="assets/laparoscope.py",
        before="half = 0.5 * optics.baseline_m",
        after="half = -0.5 * optics.baseline_m",
        tests=("tests/envs/theatre/test_theatre.py",),
    ),
    Mutation(
        name="pixel-centre",
        file="perception/geometry.py",
        before="(np.arange(self.width) + 0.5 - self.cx)",
        after="(np.arange(self.width) - self.cx)",
        tests=("tests/perception/test_geometry.py",),
    ),
    Mutation(
        name="latency-a-tick-late",
        file="envs/loop/perception_server.py",
        before="self._pipeline[0].done_ns <= now_ns",
        after="self._pipeline[0].done_ns < now_ns",
        tests=("tests/envs/loop/test_closed_loop.py",),
    ),
    Mutation(
        name="oldest-wins-before-perception",
        file="envs/loop/perception_server.py",
        before="self._waiting.append(newer)",
        after="self._waiting.append(older)",
        tests=("tests/envs/loop/test_closed_loop.py",),
    ),
    Mutation(
        name="oldest-wins-after-perception",
        file="envs/loop/closed_loop.py",
        before="one.captured_ns <= self.newest_served.captured_ns",
        after="one.captured_ns >= self.newest_served.captured_ns",
        tests=("tests/envs/loop/test_closed_loop.py",),
    ),
    Mutation(
        name="trocar-constraint-dropped",
        file="control/arm/rcm_controller.py",
        before="self._constraints = [self._trocar_task, *constraints]",
        after="self._constraints = [*constraints]",
        tests=("tests/control/arm/test_rcm_controller.py",),
    ),
    Mutation(
        name="ball-radius-forgotten",
        file="envs/tasks/task_env.py",
        before="offset - INSTRUMENT.tip_radius_m * normal",
        after="offset",
        tests=("tests/envs/tasks/test_task_env.py",),
    ),
    Mutation(
        name="relative-error-over-the-estimate",
        file="perception/metrics.py",
        before="bias_mm=error.sum(),\n            abs_rel=(size / truth).sum()",
        after="bias_mm=error.sum(),\n            abs_rel=(size / estimate).sum()",
        tests=("tests/perception/test_metrics.py",),
    ),
    Mutation(
        name="observed-force-in-the-true-cameras-frame",
        file="envs/tasks/task_env.py",
        before="bounded(force,",
        after="bounded(self.loop.theatre.world_from_camera()[:3, :3].T @ self.loop.reading().contact_force_in_world,",
        tests=("tests/envs/loop/test_closed_loop.py",),
    ),
    Mutation(
        name="known-force-in-the-true-cameras-frame",
        file="envs/loop/closed_loop.py",
        before="contact_force_in_camera=force,",
        after="contact_force_in_camera=self.theatre.world_from_camera()[:3, :3].T @ reading.contact_force_in_world,",
        tests=("tests/envs/loop/test_closed_loop.py",),
    ),
    Mutation(
        name="hand-eye-inverse",
        file="perception/calibration/hand_eye.py",
        before="placed = invert_transform(x) @ flange_from_world",
        after="placed = x @ flange_from_world",
        tests=("tests/perception/calibration/test_hand_eye.py",),
    ),
    Mutation(
        name="normal-flipped",
        file="control/targeting/surface_patch.py",
        before="normal = np.array([gradient[0], gradient[1], -1.0])",
        after="normal = np.array([-gradient[0], -gradient[1], 1.0])",
        tests=("tests/control/targeting/test_surface_patch.py",),
    ),
    Mutation(
        name="true-normal-flipped",
        file="envs/tasks/surface_point.py",
        before="_cross(b - a, c - a)",
        after="_cross(c - a, b - a)",
        tests=("tests/envs/tasks/test_task_env.py",),
    ),
    Mutation(
        name="success-hold-ignored",
        file="envs/tasks/reach.py",
        before="self._held_ns >= round(self.config.success_hold_s * 1e9)",
        after="self._held_ns > 0",
        tests=("tests/envs/tasks/test_reach.py::test_leaving_the_target_starts_the_hold_over",),
    ),
    Mutation(
        name="rcm-of-the-camera-arm-ignored",
        file="envs/tasks/task_env.py",
        before="max(self.loop.max_rcm_error_m.values()) > self.config.harm_rcm_m",
        after='self.loop.max_rcm_error_m["tool"] > self.config.harm_rcm_m',
        tests=("tests/envs/tasks/test_task_env.py",),
    ),
    Mutation(
        name="rcm-of-the-tool-arm-ignored",
        file="envs/tasks/task_env.py",
        before="max(self.loop.max_rcm_error_m.values()) > self.config.harm_rcm_m",
        after='self.loop.max_rcm_error_m["camera"] > self.config.harm_rcm_m',
        tests=("tests/envs/tasks/test_task_env.py",),
    ),
)


def copy_of_the_tree(folder):
    """Copy what the tests need; the links under `src` are relative and lead into the copy."""
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)


def run_tests(folder, tests):
    """Run tests in a copy, on the copy's code; stop at the first failure."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "COV_"))}
    environment |= {"PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-m", "not slow", "-p", "no:cacheprovider", *tests]
    return subprocess.run(  # noqa: S603  our own command
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=900, check=False
    )


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_every_mutation_has_its_place_in_the_code(mutation):
    assert (ROOT / mutation.file).read_text().count(mutation.before) == 1
    assert mutation.before != mutation.after
    assert all((ROOT / test.partition("::")[0]).is_file() for test in mutation.tests)


@pytest.mark.slow
def test_without_a_mutation_the_tests_of_all_mutations_pass(tmp_path):
    copy_of_the_tree(tmp_path)
    done = run_tests(tmp_path, dict.fromkeys(test for mutation in MUTATIONS for test in mutation.tests))
    assert done.returncode == pytest.ExitCode.OK, done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda mutation: mutation.name)
def test_a_mutation_is_noticed(tmp_path, mutation):
    copy_of_the_tree(tmp_path)
    file = tmp_path / mutation.file
    file.write_text(file.read_text().replace(mutation.before, mutation.after))
    done = run_tests(tmp_path, mutation.tests)
    # A test that ran and failed; a file that cannot be imported ends with another status.
    assert done.returncode == pytest.ExitCode.TESTS_FAILED, done.stdout
    assert "1 failed" in done.stdout
