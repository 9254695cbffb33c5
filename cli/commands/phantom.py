"""`laploop phantom`: an organ as a file that a theatre takes as its phantom."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from laploop.assets.anatomy.phantom_body import PHANTOMS
from laploop.cli.console import ResultTable
from laploop.cli.parsing import parse
from laploop.configuration import Seed


@dataclass(frozen=True, kw_only=True)
class PhantomArguments:
    """Write the closed surface of an organ in millimetres, which other commands take with `--phantom FILE`."""

    family: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(PHANTOMS) + "}")]
    """Kind of organ."""
    seed: Seed = 0
    """Makes one organ of the kind."""
    out: Path
    """File to write: .stl, .obj or .ply."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(PhantomArguments, arguments, "phantom")

    from laploop.studies.synthesis.phantom_file import write_phantom  # slow to import

    body = write_phantom(chosen.family, chosen.seed, chosen.out)
    table = ResultTable(f"phantom {chosen.family}, seed {chosen.seed}")
    table.row("triangles", str(len(body.triangles)))
    for axis, size in zip("xyz", 1e3 * (body.points.max(axis=0) - body.points.min(axis=0)), strict=True):
        table.row(f"size along {axis}", size, "mm")
    table.show(chosen.out)
    return 0
