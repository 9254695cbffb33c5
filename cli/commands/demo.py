"""`laploop demo`: a first look, from any folder."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from laploop.cli.commands import run
from laploop.cli.output import SUMMARY
from laploop.cli.parsing import parse

_EPISODE = ("--task", "reach", "--perception", "compact", "--motion", "breathing", "--hold-s", "4")


@dataclass(frozen=True, kw_only=True)
class DemoArguments:
    """Touch a point on breathing tissue, and hold it for four seconds; leaves a recording, a picture and a summary.

    It is a `laploop run` with options of its own; the exit status is 1 if the point was not held.
    """

    out: Path = Path("laploop-demo")
    """Folder to write to; made where it does not exist."""
    seed: int = 0
    """Decides the tissue, the target and all noise."""
    seconds: float = 15.0
    """Simulated time after which the episode ends, in s, if the point was not held before."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(DemoArguments, arguments, "demo")
    status = run.main([*_EPISODE, "--seed", str(chosen.seed), "--seconds", str(chosen.seconds), "--out", str(chosen.out)])
    if status == 0 and not json.loads((chosen.out / SUMMARY).read_text(encoding="utf-8"))["success"]:
        sys.stderr.write("laploop demo: the point was not held to the end\n")
        return 1
    sys.stderr.write(f"laploop demo: `laploop view {chosen.out}` opens the recording, with --web in the browser\n")
    return status
