"""`laploop fidelity`: what the cheaper simulation changes."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.studies.fidelity.config import FidelityConfig


@dataclass(frozen=True, kw_only=True)
class FidelityArguments:
    """Press tissues at both fidelities by the same commands, run the same episodes of reach, and compare.

    Writes `fidelity.md` and `summary.json`.
    """

    fidelity: Inlined[FidelityConfig] = field(default_factory=FidelityConfig)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(FidelityArguments, arguments, "fidelity")

    from laploop.studies.fidelity.run import as_markdown, measure_fidelity  # slow to import

    with OutputFolder(chosen.out, "fidelity") as folder:
        with progress_bar("tissues", chosen.fidelity.seeds) as advance_to:
            result = measure_fidelity(chosen.fidelity, advance_to)
        folder.write_text("fidelity.md", as_markdown(result))
        folder.write_summary(result, config=chosen, seed=chosen.fidelity.first_seed)
    overall = result["overall"]
    table = ResultTable(f"fast against full, {chosen.fidelity.seeds} tissues")
    table.row("force, full", overall["force_full_n"], "N")
    table.row("difference of force, RMS", overall["force_rms_n"], "N")
    table.row("difference of the surface, RMS", overall["surface_rms_mm"], "mm")
    table.row("difference of exact depth, mean", overall["depth_mae_mm"], "mm")
    for name, one in result["episodes"].items():
        table.row(f"success of reach, {name}", 100.0 * one["success_rate"], "%")
    table.show(folder.path)
    return 0
