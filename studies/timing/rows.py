"""What the bench measures of a whole checkout: steps, episodes, resets, physics, camera, memory; each in every fidelity."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.interleaving import in_turns
from laploop.studies.timing.probe_process import ProbeProcess, Sample, start_probe


@dataclass(frozen=True, kw_only=True)
class Row:
    """A quantity, where it stands among the results, and how a probe measures it."""

    path: tuple[str, ...]
    """Nested keys."""
    measure: str
    """What the probe is asked for."""
    options: Mapping[str, Any]
    unit: str
    clock: Literal["wall", "cpu"] = "wall"
    """Wall-clock time for what people wait for, CPU time for what one core computes."""
    rate: bool = False
    """Whether it is units a second, more being better, instead of milliseconds a unit."""
    warm_up: bool = True
    key: str = ""
    """Where the quantity stands in a block's sample, if it is not a time."""

    @property
    def name(self) -> str:
        """The path in one line."""
        return " > ".join(self.path)

    def value(self, sample: Sample) -> float:
        """Return the quantity of one block."""
        if self.key:
            return float(sample[self.key])
        units, seconds = float(sample["units"]), float(sample[f"{self.clock}_s"])
        return units / seconds if self.rate else 1e3 * seconds / units


@dataclass(frozen=True, kw_only=True)
class RowResult:
    """What the rounds gave."""

    row: Row
    samples: Sequence[Sample]
    others: Sequence[Sample] = field(default=())
    """Those of the other checkout, if there is one, round by round."""
    other_fidelity: str = ""
    """At which fidelity that one ran: one that knows none runs at full."""

    @property
    def values(self) -> list[float]:
        """The quantity, round by round."""
        return [self.row.value(sample) for sample in self.samples]

    @property
    def other_values(self) -> list[float]:
        """That of the other checkout."""
        return [self.row.value(sample) for sample in self.others]


def rows(config: BenchConfig) -> Iterator[Row]:
    """Yield all rows but those of memory. Episodes come last, when everything is warm."""
    for fidelity in config.fidelities:
        common = {"fidelity": fidelity, "seed": config.seed}
        for observation in config.observations:
            yield Row(
                path=("env_steps_per_s", fidelity, observation, "single"),
                measure="steps",
                options={**common, "observation": observation, "count": config.steps},
                unit="steps of 40 ms a second",
                rate=True,
            )
            for count in config.vectors:
                yield Row(
                    path=("env_steps_per_s", fidelity, observation, f"vector_{count}"),
                    measure="vector steps",
                    # About as many steps of environments as of a single one.
                    options={
                        **common,
                        "observation": observation,
                        "environments": count,
                        "count": max(2, math.ceil(config.steps / count)),
                    },
                    unit="steps of 40 ms a second",
                    rate=True,
                )
        for key, pressing in (("free", False), ("pressing", True)):
            yield Row(
                path=("physics_ms", fidelity, key),
                measure="physics",
                options={**common, "pressing": pressing},
                unit="ms of CPU a 40 ms",
                clock="cpu",
            )
        yield Row(
            path=("theatre_ms", fidelity),
            measure="physics steps",
            options=common,
            unit="ms of CPU a 40 ms",
            clock="cpu",
        )
        yield Row(path=("capture_ms", fidelity), measure="captures", options=common, unit="ms of CPU", clock="cpu")
        for path, observation in (("reset_ms", "depth_compact"), ("reset_state_ms", "state")):
            for key, new in (("new", True), ("cached", False)):
                yield Row(
                    path=(path, fidelity, key),
                    measure="resets",
                    options={**common, "observation": observation, "new": new},
                    unit="ms",
                )
    for fidelity in config.fidelities:
        yield Row(
            path=("real_time_factor", fidelity),
            measure="episodes",
            options={
                "fidelity": fidelity,
                "seed": config.seed,
                "perception": config.perception,
                "seconds": config.seconds,
            },
            unit="of real time",
            rate=True,
            warm_up=False,
        )


def measure_rows(
    config: BenchConfig, this: ProbeProcess, other: ProbeProcess | None, progress: Callable[[float], None]
) -> list[RowResult]:
    """Measure all rows but those of memory, with two probes in turns; `progress` is called with the fraction done."""
    chosen = list(rows(config))
    probes = {"this": this} | ({} if other is None else {"other": other})
    results = []
    for number, row in enumerate(chosen):
        progress(number / len(chosen))
        ran_at = {name: probe.prepare(row.measure, row.options)["fidelity"] for name, probe in probes.items()}
        rounds = config.episodes if row.measure == "episodes" else config.rounds
        samples = in_turns(probes, rounds, warm_up=row.warm_up)
        results.append(
            RowResult(
                row=row,
                samples=samples["this"],
                others=samples.get("other", ()),
                other_fidelity=ran_at.get("other", ""),
            )
        )
    progress(1.0)
    return results


def memory_rows(config: BenchConfig) -> Iterator[tuple[Row, ...]]:
    """Yield the rows of memory, those together that one measurement serves."""
    for fidelity in config.fidelities:
        options = {"fidelity": fidelity, "observation": "depth_compact", "seed": config.seed}
        yield tuple(
            Row(path=(path, fidelity), measure="memory", options=options, unit="MB", key=key)
            for path, key in (("memory_mb", "peak_mb"), ("memory_resident_mb", "resident_mb"))
        )
        if len(config.vectors) > 1:
            fewest, most = min(config.vectors), max(config.vectors)
            yield (
                Row(
                    path=("memory_per_environment_mb", fidelity),
                    measure="vector memory",
                    options={"fidelity": fidelity, "seed": config.seed, "fewest": fewest, "most": most},
                    unit="MB",
                    key="each_mb",
                ),
            )


def measure_memory(
    config: BenchConfig, source: Path, other_source: Path | None, progress: Callable[[float], None]
) -> list[RowResult]:
    """Measure what a process holds that has run one environment with `compact`, and what each environment of a vector adds.

    Each time in a new process.

    Args:
        config: At which fidelities to measure.
        source: Folder that holds the package to measure.
        other_source: The same of the other checkout.
        progress: Called with the fraction done.
    """
    sources = {"this": source} | ({} if other_source is None else {"other": other_source})
    results = []
    chosen = list(memory_rows(config))
    for number, rows_of_one in enumerate(chosen):
        progress(number / len(chosen))
        samples: dict[str, list[Sample]] = {}
        ran_at: dict[str, str] = {}
        for name, place in sources.items():
            with start_probe(place, f"{name} checkout") as probe:
                ran_at[name] = probe.prepare(rows_of_one[0].measure, rows_of_one[0].options)["fidelity"]
                samples[name] = [probe.block(0)]
        others, other_fidelity = samples.get("other", ()), ran_at.get("other", "")
        results += [
            RowResult(row=row, samples=samples["this"], others=others, other_fidelity=other_fidelity) for row in rows_of_one
        ]
    progress(1.0)
    return results
