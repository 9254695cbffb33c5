"""Command lines from frozen dataclasses."""

from collections.abc import Sequence
from typing import TypeVar

import tyro

Arguments = TypeVar("Arguments")


def parse(kind: type[Arguments], arguments: Sequence[str], command: str) -> Arguments:
    """Read a command's arguments.

    Args:
        kind: A dataclass whose docstrings describe the options.
        arguments: What follows the command's name.
        command: The command's name.

    Raises:
        LaploopError: If a value is not allowed.
        SystemExit: With status 2 after a message if an option is unknown or of the wrong type, with 0 after `--help`.
    """
    return tyro.cli(kind, args=list(arguments), prog=f"laploop {command}")
