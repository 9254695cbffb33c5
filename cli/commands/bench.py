"""`laploop bench`: how long every stage takes on this machine."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.bench_result import BenchResult, as_csv, as_markdown
from laploop.studies.timing.fetch_comparison import OURS
from laploop.studies.timing.interleaving import Spread


@dataclass(frozen=True, kw_only=True)
class BenchArguments:
    """Measure every stage of the loop, and the loop as a whole, on this machine.

    Writes `bench.json`, `bench.csv`, `bench.md` and `summary.json`; `against.json` and `fetch.json` where another checkout or
    Fetch is measured in turns with this one. Let nothing else run at the same time; the machine's load before the measurement
    is kept with the results. Ratios bear a busy machine better than times do.
    """

    bench: Inlined[BenchConfig] = field(default_factory=BenchConfig)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(BenchArguments, arguments, "bench")

    from laploop.studies.timing.bench import run_bench  # slow to import

    with OutputFolder(chosen.out, "bench") as folder:
        with progress_bar("measuring", 1.0) as advance_to:
            result = run_bench(chosen.bench, advance_to)
        results = result.as_dict()
        folder.write_json("bench.json", results)
        folder.write_text("bench.csv", as_csv(result))
        folder.write_text("bench.md", as_markdown(result))
        if result.against is not None:
            folder.write_json("against.json", result.against)
        if result.fetch is not None:
            folder.write_json("fetch.json", result.fetch)
        folder.write_summary(results, config=chosen, seed=chosen.bench.seed)
    _show(result, results, folder.path)
    return 0


def _show(result: BenchResult, results: dict[str, Any], folder: Path) -> None:
    machine = result.machine
    table = ResultTable(f"medians on {machine['cpu']}, {machine['usable_cores']} cores")
    for stage in result.stages:
        table.row(stage.name, stage.p50_ms, "ms" if stage.limit_ms is None else f"ms (target: {stage.limit_ms:g})")
    for one in result.rows:
        table.row(one.row.name, Spread.of(one.values).median, one.row.unit)
    factor = results["loop"]["real_time_factor"]["median"]
    table.row("real-time factor", factor, f"(target: {results['loop']['limit_real_time_factor']:g})")
    if result.against is not None:
        ratios = ResultTable("this checkout over the other, measured in turns; quartiles")
        for one in result.rows:
            ratio = Spread.of_ratio(one.values, one.other_values)
            better = "more is better" if one.row.rate else "less is better"
            ratios.row(one.row.name, f"{ratio.median:.2f}", f"({ratio.p25:.2f} to {ratio.p75:.2f}; {better})")
        ratios.show()
    if result.fetch is not None:
        fetch = ResultTable("CPU time of 40 ms of the world, this environment over Fetch; quartiles")
        for fidelity, observation in OURS:
            ratio = Spread(**result.fetch[fidelity][observation]["ratio"])
            fetch.row(f"{fidelity}, {observation}", f"{ratio.median:.2f}", f"({ratio.p25:.2f} to {ratio.p75:.2f})")
        picture = result.fetch["fetch"]["picture"]
        fetch.row("Fetch", result.fetch["fetch"]["cpu_ms"]["median"], f"ms {'with' if picture else 'without'} its picture")
        fetch.show()
    table.show(folder)
