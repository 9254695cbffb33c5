"""Entry point of the `laploop` command: finds the subcommand and turns its errors into messages and exit statuses.

Only the subcommand that was asked for is imported, so that `laploop --help` is quick.
"""

import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.metadata import version
from types import FrameType

from laploop.errors import InfeasibleError, LaploopError, SimulationError, UnknownNameError, WorkerError

EXIT_OK = 0
EXIT_FAILED = 1
"""The command did not do what it was asked."""
EXIT_BAD_INPUT = 2
EXIT_INTERRUPTED = 130


COMMANDS = {
    "speed": "time a depth model alone, frame after frame",
    "export": "write a depth network as ONNX",
    "run": "run one closed-loop episode; recording, figure, summary",
    "trials": "run many episodes, one a seed; success rate and error table",
    "tasks": "run every task over many seeds; what is as asked, in a table",
    "bench": "measure every stage of the loop on this machine",
    "collect": "collect stripe frames paired with a reference camera's depth",
    "synthesize": "render stripe frames with exact depth, for training",
    "train": "train a depth network on rendered frames or collected pairs",
    "characterize": "measure the stripes' contrast against distance",
    "calibrate": "calibrate cameras, projector and arm; true residuals",
    "evaluate": "measure estimators on tissues never seen in training",
}
"""What each subcommand, `laploop.cli.commands.NAME`, does in one line."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: What follows `laploop`; None takes the process's own.

    Returns:
        Exit status: 0 done, 1 not done, 2 bad input, 130 interrupted.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if not arguments or arguments[0] in {"-h", "--help", "help"}:
        (sys.stdout if arguments else sys.stderr).write(_help())
        return EXIT_OK if arguments else EXIT_BAD_INPUT
    if arguments[0] in {"-V", "--version", "version"}:
        sys.stdout.write(f"laploop {version('laploop')}\n")
        return EXIT_OK
    name, rest = arguments[0], arguments[1:]
    try:
        if name not in COMMANDS:
            raise UnknownNameError("command", name, COMMANDS)
        signal.signal(signal.SIGTERM, _interrupt)
        # The loop's matrices are small: OpenBLAS's threads gain nothing on them, and where the cores are busy they wait for
        # each other so long that a product takes ten times as long. Must be set before numpy is imported.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        status: int = import_module(f"laploop.cli.commands.{name}").main(rest)
    except LaploopError as error:
        sys.stderr.write(f"laploop{f' {name}' if name in COMMANDS else ''}: {error}\n")
        return EXIT_FAILED if isinstance(error, SimulationError | InfeasibleError | WorkerError) else EXIT_BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write(f"laploop {name}: interrupted\n")
        return EXIT_INTERRUPTED
    return status


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """Let a termination take the same way out as Ctrl-C, which leaves nothing half-written."""
    raise KeyboardInterrupt


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {summary}" for name, summary in COMMANDS.items()]
    return "\n".join(
        [
            "usage: laploop <command> [options] --out DIR",
            "",
            "Depth-in-the-loop laparoscopic control, simulated end to end.",
            "",
            "commands:",
            *lines,
            "",
            "`laploop <command> --help` lists a command's options; `laploop --version` tells the version.",
            "Every command writes its artefacts into DIR and, last, DIR/summary.json.",
            "Exit status: 0 done, 1 could not do it, 2 bad input, 130 interrupted.",
            "",
        ]
    )
