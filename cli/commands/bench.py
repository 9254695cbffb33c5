"""`laploop bench`: how long every stage takes on this machine."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.studies.timing.bench import BenchConfig, run_bench
from laploop.studies.timing.bench_result import as_csv, as_markdown


@dataclass(frozen=True, kw_only=True)
class BenchArguments:
    """Measure every stage of the loop, and the loop as a whole, on this machine.

    Writes `bench.json`, `bench.csv`, `bench.md` and `summary.json`. Let nothing else run at the same time; the machine's load
    before the measurement is kept with the results.
    """

    bench: Inlined[BenchConfig] = field(default_factory=BenchConfig)
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(BenchArguments, arguments, "bench")
    with OutputFolder(chosen.out, "bench") as folder:
        with progress_bar("measuring", 1.0) as advance_to:
            result = run_bench(chosen.bench, advance_to)
        results = result.as_dict()
        folder.write_json("bench.json", results)
        folder.write_text("bench.csv", as_csv(result))
        folder.write_text("bench.md", as_markdown(result))
        folder.write_summary(results, config=chosen, seed=chosen.bench.seed)
    machine = result.machine
    table = ResultTable(f"medians on {machine['cpu']}, {machine['usable_cores']} cores")
    for stage in result.stages:
        table.row(stage.name, stage.p50_ms, "ms" if stage.limit_ms is None else f"ms (target: {stage.limit_ms:g})")
    factor = results["loop"]["real_time_factor"]["median"]
    table.row("real-time factor", factor, f"(target: {results['loop']['limit_real_time_factor']:g})")
    table.show(folder.path)
    return 0
