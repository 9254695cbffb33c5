"""`laploop speed`: how long a depth model takes for a frame."""

from collections.abc import Sequence

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, OutputPath, parse
from laploop.configuration import configuration
from laploop.studies.timing.speed_config import SpeedConfig


@configuration
class SpeedArguments:
    """Time a depth model alone, frame after frame, from image array to depth array.

    Writes `latency_trace.csv` (which `laploop run --latency-trace` replays), `speed.png` and `summary.json`. Let nothing else
    run at the same time; the machine's load before the measurement is kept with the results.
    """

    speed: Inlined[SpeedConfig] = SpeedConfig()
    out: OutputPath


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(SpeedArguments, arguments, "speed")

    from laploop.studies.timing.machine import describe_machine
    from laploop.studies.timing.speed import measure_speed, trace_csv
    from laploop.studies.timing.speed_figure import draw_speed

    config = chosen.speed
    with OutputFolder(chosen.out, "speed") as folder:
        machine = describe_machine()
        with progress_bar("frames", config.frames) as advance_to:
            result = measure_speed(config, advance_to)
            advance_to(config.frames)
        folder.write_text("latency_trace.csv", trace_csv(result))
        processor = machine["cpu"] if config.device == "cpu" else machine["gpu"]
        how = result.backend if result.precision is None else f"{result.backend} {result.precision}"
        size = "" if config.size is None else f" ({config.size})"
        with folder.artefact("speed.png") as path:
            draw_speed(result, f"{config.model}{size}  |  {how}  |  {processor}", path)
        results = result.as_dict()
        folder.write_summary({**results, "machine": machine}, config=chosen, seed=config.seed)
    table = ResultTable(f"{config.model}{size}, {how}, {processor}, {config.frames} frames")
    table.row("mean", results["mean_ms"], "ms")
    table.row("median", results["p50_ms"], "ms")
    table.row("99 %", results["p99_ms"], "ms")
    table.row("slowest", results["max_ms"], "ms")
    table.row("frequency", results["hz"], "Hz, mean")
    table.row("on the GPU alone", results["device_p50_ms"], "ms, median")
    table.row("difference to float32", results["difference_to_fp32_mm"], "mm, mean absolute")
    table.show(folder.path)
    return 0
