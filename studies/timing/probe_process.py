"""Processes that measure on request, each with a checkout of the project, or another Python, of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Self

import laploop
from laploop.errors import InvalidValueError, MissingFileError, WorkerError

Sample = dict[str, Any]
"""Answer to a block: `units` of work, the `wall_s` and `cpu_s` that they took, and whatever else was measured."""

_SCRIPTS = Path(__file__).parent
_PACKAGE = "src/laploop/__init__.py"
_PATIENCE_S = 10.0


class ProbeProcess:
    """A process that answers lines of JSON; it idles between two questions, and ends with this one."""

    def __init__(self, name: str, command: Sequence[str], environment: Mapping[str, str]) -> None:
        """Start it and wait until it is ready; `name` stands in errors, `environment` adds to this process's own.

        Raises:
            WorkerError: If it cannot be started, or ends at once.
        """
        self._name = name
        self._folder = TemporaryDirectory(prefix="laploop-bench-")
        # Nothing that an earlier run has kept for later ones may help; kernels alone, which take half a minute, are kept.
        kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        caches = {"XDG_CACHE_HOME": self._folder.name, "WARP_CACHE_PATH": os.environ.get("WARP_CACHE_PATH", str(kept / "warp"))}
        self._said = Path(self._folder.name) / "said.txt"
        try:
            with self._said.open("wb") as said:
                self._process = subprocess.Popen(  # noqa: S603  our own script
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=said,
                    text=True,
                    env={**os.environ, **caches, **environment},
                    # Ctrl-C is for this process alone, which then ends the other.
                    start_new_session=True,
                )
        except OSError as error:
            self._folder.cleanup()
            raise WorkerError(f"cannot start {command[0]} to measure {name}: {error.strerror or error}") from error
        try:
            self.greeting = self._answer()
        except BaseException:
            self.close(at_once=True)
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close(at_once=kind is not None)

    def prepare(self, measure: str, options: Mapping[str, Any]) -> Sample:
        """Prepare a measurement, in place of the one before.

        Raises:
            WorkerError: If the process fails.
        """
        return self._ask({"measure": measure, "options": dict(options)})

    def block(self, number: int) -> Sample:
        """Measure once what was prepared; blocks are numbered from 0.

        Raises:
            WorkerError: If the process fails.
        """
        return self._ask({"block": number})

    def close(self, *, at_once: bool = False) -> None:
        """End the process, in the middle of a block if it must be `at_once`."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        if not at_once:
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=_PATIENCE_S)
        self._process.kill()
        self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._folder.cleanup()

    def _ask(self, request: Mapping[str, Any]) -> Sample:
        with suppress(OSError):
            print(json.dumps(request), file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> Sample:
        line = self._process.stdout.readline() if self._process.stdout is not None else ""
        if line:
            answer: Sample = json.loads(line)
            return answer
        said = self._said.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        raise WorkerError(f"the process that measures {self._name} ended early: {said[-1] if said else 'without a word'}")


def this_source() -> Path:
    """Return the folder that holds this very package."""
    return Path(laploop.__file__).parents[1]


def checkout_source(checkout: Path) -> Path:
    """Return the `src` of another checkout of the project.

    Raises:
        InvalidValueError: If the path is none of a folder.
        MissingFileError: If the folder is no checkout of the project.
    """
    folder = checkout.expanduser().resolve()
    if not folder.is_dir():
        raise InvalidValueError("against", checkout, "the folder of another checkout of the project")
    if not (folder / _PACKAGE).is_file():
        raise MissingFileError("package laploop", folder / _PACKAGE, "give the top folder of a checkout of the project")
    return folder / "src"


def python_path(source: Path) -> str:
    """Return what puts the package in a source folder before all others, for a process's environment."""
    return os.pathsep.join([str(source), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))])


def start_probe(source: Path, name: str) -> ProbeProcess:
    """Start a process that measures the package in a source folder.

    Raises:
        WorkerError: If it cannot be started, or finds another package.
    """
    environment = {"PYTHONPATH": python_path(source), "OPENBLAS_NUM_THREADS": os.environ.get("OPENBLAS_NUM_THREADS", "1")}
    probe = ProbeProcess(name, [sys.executable, "-P", str(_SCRIPTS / "probe.py")], environment)
    found = Path(probe.greeting["source"])
    if found.resolve() != (source / "laploop").resolve():
        probe.close()
        raise WorkerError(f"Python finds the package in {found} where {name} is to be measured, in {source}")
    return probe


def start_fetch(python: Path) -> ProbeProcess:
    """Start a process that measures Gymnasium-Robotics' Fetch, with the interpreter of an environment that has it.

    Raises:
        MissingFileError: If there is no such interpreter.
        WorkerError: If it cannot make the environment.
    """
    interpreter = python.expanduser().absolute()
    if not interpreter.is_file():
        raise MissingFileError("interpreter", interpreter, "give the bin/python of an environment with gymnasium-robotics")
    # What makes this package importable must not reach the other environment.
    environment = {"PYTHONPATH": "", "MUJOCO_GL": os.environ.get("MUJOCO_GL", "egl")}
    return ProbeProcess("Fetch", [str(interpreter), "-P", str(_SCRIPTS / "fetch_probe.py")], environment)
