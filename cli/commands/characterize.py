"""`laploop characterize`: how visible the projected stripes are, by working distance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.studies.characterization.config import CharacterizationConfig


@dataclass(frozen=True, kw_only=True)
class CharacterizeArguments:
    """Image a depth-of-field target and measure the stripes' contrast and brightness against working distance.

    Writes `characterization.png`, `characterization.csv`, `characterization.md`, `profiles.csv` and `summary.json`.
    """

    characterization: Inlined[CharacterizationConfig] = field(default_factory=CharacterizationConfig)
    mask_image: Path | None = None
    """A mask as a grey PNG (grey is transmission), instead of the built-in one; square unless it has upright stripes alone.
    Give its number of periods with `--optics.mask.stripes`."""
    mask_route: Literal["printed", "chrome"] | None = None
    """How the built-in mask was made, which decides how rough the edges of its stripes are; `--optics.mask.edge-seed` chooses
    the specimen. By default its edges are ideal."""
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(CharacterizeArguments, arguments, "characterize")
    config = chosen.characterization.with_mask(chosen.mask_image, chosen.mask_route)

    from laploop.studies.characterization.figure import draw_characterization  # slow to import
    from laploop.studies.characterization.run import as_csv, as_markdown, characterise, profiles_as_csv

    with OutputFolder(chosen.out, "characterize") as folder:
        with progress_bar("distances", len(config.measured_mm)) as advance_to:
            found = characterise(config, advance_to)
        folder.write_text("characterization.csv", as_csv(found))
        folder.write_text("characterization.md", as_markdown(found))
        folder.write_text("profiles.csv", profiles_as_csv(found))
        title = f"Stripes on an inclined depth-of-field target  |  preset {config.preset}"
        with folder.artefact("characterization.png") as path:
            draw_characterization(found, title, path)
        folder.write_summary(found.as_dict(), config=replace(chosen, characterization=config), seed=config.seed)
    table = ResultTable(f"stripes, preset {config.preset}")
    for profile in found.profiles:
        note = f"Michelson contrast, mean grey value {profile.mean_intensity:.1f}"
        table.row(f"{profile.distance_mm} mm", None if math.isnan(profile.contrast) else profile.contrast, note)
    table.show(folder.path)
    return 0
