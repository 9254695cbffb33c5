"""`laploop config`: the whole configuration of an episode as a file."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

from laploop.cli.parsing import Inlined
from laploop.cli.tree import toml_text
from laploop.cli.tree_options import TreeOptions, parse_tree, with_options


@dataclass(frozen=True, kw_only=True)
class ConfigArguments:
    """Write the configuration of an episode to the standard output, as a TOML file that `--config` takes.

    Every field is there with its value, meaning, bounds and unit, and is an option too, such as --loop.camera-hz 50. A file may
    hold a part of them only; the rest then has the defaults.
    """

    tree: Inlined[TreeOptions] = field(default_factory=TreeOptions)


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen, rest = parse_tree(ConfigArguments, arguments, "config")
    sys.stdout.write(toml_text(with_options(chosen.tree.tree(), rest, ConfigArguments)))
    return 0
