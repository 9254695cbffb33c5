"""Completion of commands and options in a shell."""

import io
from contextlib import redirect_stdout, suppress
from typing import Any, Literal

import tyro

from laploop.cli.commands import train
from laploop.cli.parsing import BOUNDS_IN_HELP, arguments_class

Shell = Literal["bash", "zsh", "fish"]


def argument_kinds(commands: list[str]) -> dict[str, Any]:
    """Return the class that holds the arguments of each command; which options training has depends on the network."""
    return {name: train.arguments_of("compact") if name == "train" else arguments_class(name) for name in commands}


def completion_script(commands: list[str], shell: Shell) -> str:
    """Return the script that completes all commands with their options and choices in a shell."""
    text = io.StringIO()
    with redirect_stdout(text), suppress(SystemExit):
        tyro.extras.subcommand_cli_from_dict(
            argument_kinds(commands),
            prog="laploop",
            args=["--tyro-print-completion", shell],
            registry=BOUNDS_IN_HELP,
        )
    return text.getvalue()
