"""`laploop presets`: everything that has a name in an episode's options."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

from laploop.cli.parsing import parse
from laploop.envs.presets import presets


@dataclass(frozen=True, kw_only=True)
class PresetsArguments:
    """List the names that --timing, --optics, --tissue-class, --fidelity, --actuation, --trocar and --motion take.

    Each comes with its source.
    """


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    parse(PresetsArguments, arguments, "presets")
    listed = list(presets())
    width = max(len(preset.name) for preset in listed)
    for option, group in groupby(listed, key=lambda preset: preset.option):
        sys.stdout.write(f"--{option}\n")
        sys.stdout.writelines(f"  {preset.name:<{width}}  {preset.source}\n" for preset in group)
    return 0
