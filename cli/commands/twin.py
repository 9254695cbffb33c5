"""`laploop twin`: the stripe camera against an independent path tracer."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.studies.twin.config import LightConfig


@dataclass(frozen=True, kw_only=True)
class TwinArguments:
    """Render scenes with the stripe camera and with Mitsuba 3, compare, and measure networks under the path tracer's light.

    Needs the extra `twin`. Writes `twin.png` and `summary.json`.
    """

    light: Inlined[LightConfig] = field(default_factory=LightConfig)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(TwinArguments, arguments, "twin")

    from laploop.studies.twin.compare import compare_with_twin  # slow to import
    from laploop.studies.twin.figure import draw_twin
    from laploop.studies.twin.light import count_images, measure_light
    from laploop.studies.twin.render import check_mitsuba

    check_mitsuba()
    with OutputFolder(chosen.out, "twin") as folder:
        with progress_bar("scenes", 1.0) as advance_to:
            compared = compare_with_twin(advance_to)
        with folder.artefact("twin.png") as path:
            draw_twin(compared, "Stripe camera against path tracer", path)
        with progress_bar("images", count_images(chosen.light)) as advance_to:
            rows = measure_light(chosen.light, advance_to)
        found = compared.as_dict()
        folder.write_summary({**found, "light": rows}, config=chosen, seed=chosen.light.seed)
    table = ResultTable("stripe camera against path tracer")
    for scene in found["scenes"]:
        table.row(
            f"stripe edges, {scene['scene']}", scene["edge_median_px"], f"px apart, 95 % within {scene['edge_p95_px']:.2g} px"
        )
    for spot in found["spot"]:
        ours, theirs = spot["half_mm"]["stripe_camera"], spot["half_mm"]["path_tracer"]
        table.row(f"width of a line, subsurface {spot['profile']}", ours, f"mm at half of its peak, against {theirs:.3g} mm")
    for row in rows:
        table.row(f"{row['model']}, {row['light']}", row["mae_mm"], f"mm, {row['ratio']:.2f} of the stripe camera")
    table.show(folder.path)
    return 0
