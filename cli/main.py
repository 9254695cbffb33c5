"""Entry point of the `laploop` command: finds the subcommand and turns its errors into messages and exit statuses.

Only the subcommand that was asked for is imported, so that `laploop --help` is quick.
"""

import atexit
import errno
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from laploop.cli.stop_signals import STOP_SIGNALS, stop_signals
from laploop.cli.streams import patient_streams
from laploop.errors import (
    InfeasibleError,
    LaploopError,
    LaploopNote,
    MissingFileError,
    SimulationError,
    UnknownNameError,
    WorkerError,
)

EXIT_OK = 0
EXIT_FAILED = 1
"""The command did not do what it was asked."""
EXIT_BAD_INPUT = 2


COMMANDS = {
    "demo": "touch a point on breathing tissue; a first look, anywhere",
    "doctor": "check this machine: versions, caches, display, extras, speed",
    "view": "open a recording in the viewer, or in the browser",
    "completion": "print the completion of commands and options for a shell",
    "speed": "time a depth model alone, frame after frame",
    "export": "write a depth network as ONNX",
    "config": "write the configuration of an episode as a file",
    "presets": "list named timings, optics, arms, trocars and motions",
    "run": "run one closed-loop episode; recording, figure, summary",
    "trials": "run many episodes, one a seed; success rate and error table",
    "study": "sweep conditions with the same seeds; latency, delays, error budget",
    "tasks": "run every task over many seeds; which meets its targets",
    "demonstrate": "make a data set of demonstrations, for Minari or LeRobot",
    "replay": "repeat an episode of such a data set; what differs",
    "bench": "measure every stage of the loop on this machine",
    "fidelity": "measure what the cheaper simulation changes",
    "collect": "collect stripe frames paired with a reference camera's depth",
    "synthesize": "render stripe frames with exact depth, for training",
    "phantom": "write an organ as a file that a theatre takes as its phantom",
    "train": "train a depth network on rendered frames or collected pairs",
    "characterize": "measure the stripes' contrast against distance",
    "calibrate": "calibrate cameras, projector and arm; true residuals",
    "evaluate": "measure estimators on tissues never seen in training",
    "predict": "depth of your own camera's pictures",
    "import-pairs": "make a data set of your own pictures and clouds",
}
"""What each subcommand, `laploop.cli.commands.NAME` with underscores, does in one line."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: What follows `laploop`; None takes the process's own.

    Returns:
        Exit status: 0 done, 1 not done, 2 bad input, 130 interrupted, 143 terminated.
    """
    with patient_streams() as (out, error):
        status = _run(list(sys.argv[1:] if arguments is None else arguments))
        out.flush()
        # A reader that left, such as `head`, has seen enough.
        if out.error is not None and not isinstance(out.error, BrokenPipeError):
            error.write(f"laploop: cannot write to the standard output: {out.error.strerror}\n")
            status = status or EXIT_FAILED
        error.flush()
        if arguments is None and status in {128 + number for number in STOP_SIGNALS}:
            # What Python does at its end, without taking torch apart, which may last seconds.
            atexit._run_exitfuncs()  # noqa: SLF001
            os._exit(status)
        return status


def _run(arguments: list[str]) -> int:
    if not arguments or arguments[0] in {"-h", "--help", "help"}:
        (sys.stdout if arguments else sys.stderr).write(_help())
        return EXIT_OK if arguments else EXIT_BAD_INPUT
    if arguments[0] in {"-V", "--version", "version"}:
        sys.stdout.write(f"laploop {version('laploop')}\n")
        return EXIT_OK
    name, rest = arguments[0], arguments[1:]
    if name not in COMMANDS:
        sys.stderr.write(f"laploop: {UnknownNameError('command', name, COMMANDS)}\n")
        return EXIT_BAD_INPUT
    # The loop's matrices are small: OpenBLAS's threads gain nothing on them, and where the cores are busy they wait for
    # each other so long that a product takes ten times as long. The limit is for this process, the variable for its workers.
    if "OPENBLAS_NUM_THREADS" not in os.environ:
        threadpool_limits(1, user_api="blas")
        os.environ["OPENBLAS_NUM_THREADS"] = "1"
    # Rerun would log on its own that the disk is full, which the recorder notices by itself.
    os.environ.setdefault("RUST_LOG", "off")
    with stop_signals(f"laploop {name}") as received, _notes_in_one_line(name):
        try:
            _require_working_folder()
            status: int = import_module(f"laploop.cli.commands.{name.replace('-', '_')}").main(rest)
        except BaseException as error:
            if isinstance(error, SystemExit) and not received:
                return error.code if isinstance(error.code, int) else EXIT_FAILED if error.code else EXIT_OK
            outcome = _outcome(error, received)
            if outcome is None:
                raise
            message, status = outcome
            lines = [message, *getattr(error, "__notes__", ())]
            sys.stderr.write(f"laploop {name}: {'; '.join(' '.join(line.split()) for line in lines)}\n")
    return status


@contextmanager
def _notes_in_one_line(command: str) -> Iterator[None]:
    """Show what the library has to say as this program's own words, without the place in the code that said it."""
    show = warnings.showwarning

    def say(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        if issubclass(category, LaploopNote):
            sys.stderr.write(f"laploop {command}: {message}\n")
        else:
            show(message, category, *place, **more)

    warnings.showwarning = say
    try:
        yield
    finally:
        warnings.showwarning = show


def _outcome(error: BaseException, received: Sequence[int]) -> tuple[str, int] | None:
    """Return what to say of an error, in one line, and the exit status; None for a mistake of ours."""
    if received:
        return STOP_SIGNALS[signal.Signals(received[0])], 128 + received[0]
    if isinstance(error, KeyboardInterrupt):
        return STOP_SIGNALS[signal.SIGINT], 128 + signal.SIGINT
    if isinstance(error, LaploopError):
        failed = isinstance(error, SimulationError | InfeasibleError | WorkerError)
        failed = failed or _is_fault(error.__cause__) or _is_fault(error.__context__)
        return str(error), EXIT_FAILED if failed else EXIT_BAD_INPUT
    if isinstance(error, OSError):
        place = f"{error.filename}: " if error.filename else ""
        return f"{place}{error.strerror or error}", EXIT_FAILED if _is_fault(error) else EXIT_BAD_INPUT
    return ("out of memory", EXIT_FAILED) if isinstance(error, MemoryError) else None


def _is_fault(error: BaseException | None) -> bool:
    """Return whether the machine failed, rather than that it was given a bad path."""
    return isinstance(error, OSError) and error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOMEM}


def _require_working_folder() -> None:
    try:
        Path.cwd()
    except FileNotFoundError as error:
        raise MissingFileError("working folder", os.environ.get("PWD", "."), "change to one that exists") from error


def _help() -> str:
    width = max(map(len, COMMANDS))
    commands = "\n".join(f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items())
    return f"""usage: laploop <command> [options] --out DIR

Depth-in-the-loop laparoscopic control, simulated end to end.

commands:
{commands}

`laploop <command> --help` lists a command's options; `laploop --version` shows the version.
Commands with --out write their artefacts into DIR and, last, DIR/summary.json. `laploop completion SHELL` completes them all.
Exit status: 0 done, 1 could not do it, 2 bad input, 130 interrupted, 143 terminated.
"""
