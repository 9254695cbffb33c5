"""`laploop completion`: completion of commands and options in a shell."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import tyro

from laploop.cli.completion import Shell, completion_script
from laploop.cli.parsing import parse


@dataclass(frozen=True, kw_only=True)
class CompletionArguments:
    """Print a script that completes commands, options and choices; docs/seeing.md says where each shell wants it."""

    shell: tyro.conf.Positional[Shell]
    """Which shell."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    from laploop.cli.main import COMMANDS  # it imports this module

    chosen = parse(CompletionArguments, arguments, "completion")
    sys.stdout.write(completion_script(list(COMMANDS), chosen.shell))
    return 0
