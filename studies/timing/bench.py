"""How long everything takes on this machine: every stage alone, and whole steps, resets and episodes."""

from collections.abc import Callable
from contextlib import ExitStack

from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.bench_result import BenchResult
from laploop.studies.timing.fetch_comparison import compare_with_fetch
from laploop.studies.timing.machine import describe_machine
from laploop.studies.timing.probe_process import checkout_source, start_fetch, start_probe, this_source
from laploop.studies.timing.rows import measure_memory, measure_rows
from laploop.studies.timing.stage_times import stage_times
from laploop.studies.timing.start_times import measure_starts


def run_bench(config: BenchConfig, progress: Callable[[float], None] | None = None) -> BenchResult:
    """Measure every stage alone, then whole steps, resets and episodes; `progress` is called with the fraction done, 0 to 1.

    The latter run in processes of their own, so that another checkout, or Fetch, can be measured in turns with this one.

    Raises:
        InvalidValueError: If `against` is no folder.
        MissingFileError: If it is no checkout of the project, or there is no interpreter at `fetch`.
        WorkerError: If a process cannot be started, or fails.
        SimulationError: If no episode brings the tip onto the tissue.
    """
    report = progress or (lambda _fraction: None)
    report(0.0)
    machine = describe_machine()
    other_source = None if config.against is None else checkout_source(config.against)
    with ExitStack() as stack:
        # What cannot be measured is found before any of the work.
        fetch = None if config.fetch is None else stack.enter_context(start_fetch(config.fetch))
        other = None if other_source is None else stack.enter_context(start_probe(other_source, "the other checkout"))
        this = stack.enter_context(start_probe(this_source(), "this checkout"))
        stages = stage_times(config, lambda done: report(0.25 * done))
        results = measure_rows(config, this, other, lambda done: report(0.25 + 0.6 * done))
        if fetch is not None:
            beside = stack.enter_context(start_probe(this_source(), "this checkout"))
            compared = compare_with_fetch(fetch, (this, beside), seed=config.seed, steps=config.steps, rounds=config.rounds)
    report(0.88)
    results += measure_starts(config, this_source(), other_source)
    report(0.9)
    results += measure_memory(config, this_source(), other_source, lambda done: report(0.9 + 0.1 * done))
    return BenchResult(
        machine=machine,
        stages=tuple(stages),
        rows=tuple(results),
        fetch=None if fetch is None else compared,
    )
