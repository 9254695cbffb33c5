"""Completion of commands and options in a shell."""

import io
from contextlib import redirect_stdout, suppress
from importlib import import_module
from typing import Any, Literal

import tyro

from laploop.cli.parsing import BOUNDS_IN_HELP

Shell = Literal["bash", "zsh", "fish"]


def argument_kinds(commands: list[str]) -> dict[str, Any]:
    """Return the class that holds the arguments of each command: the one in its module whose name ends so."""
    kinds: dict[str, Any] = {}
    for name in commands:
        module = import_module(f"laploop.cli.commands.{name.replace('-', '_')}")
        (kind,) = (
            one
            for key, one in vars(module).items()
            if key.endswith("Arguments") and getattr(one, "__module__", "") == module.__name__
        )
        # Which options training has depends on the network.
        kinds[name] = module.arguments_of("compact") if hasattr(module, "arguments_of") else kind
    return kinds


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
