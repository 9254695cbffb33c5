"""The results of the bench, as plain data, CSV and Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.studies.csv_text import csv_text
from laploop.studies.timing.fetch_comparison import fetch_sentence
from laploop.studies.timing.row_tables import ratios_markdown, row_medians, row_ratios, rows_markdown
from laploop.studies.timing.rows import RowResult

LIMITS_MS: Mapping[str, float] = {
    "stripe frame": 20.0,
    "depth: compact": 40.0,
    "reference capture, 2x2": 1500.0,
    "reprojection, full cloud": 500.0,
}
"""Targets of the loop, and of collecting a data set, on a machine with two cores; for the median."""

LIMITS_P99_MS: Mapping[str, float] = {
    "control tick alone: prediction": 1.2,
    "control tick alone: kinematics, QP, prediction": 1.2,
}
"""Targets for the 99th percentile, of ticks one after another, without physics on the core in between: whole ones, and without
the measurement of a depth frame."""

LIMIT_REAL_TIME_FACTOR = 0.3


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Wall-clock time of a stage, in milliseconds a call."""

    name: str
    calls: int
    p5_ms: float
    p50_ms: float
    p95_ms: float
    p99_ms: float
    limit_ms: float | None
    """Target for the median; None where there is none."""
    limit_p99_ms: float | None
    """Target for the 99th percentile."""

    @classmethod
    def of(cls, name: str, seconds: Sequence[float] | NDArray[np.float64]) -> "Stage":
        """Make it from the durations of all calls."""
        p5, p50, p95, p99 = np.percentile(np.asarray(seconds) * 1e3, [5, 50, 95, 99])
        return cls(
            name=name,
            calls=len(seconds),
            p5_ms=float(p5),
            p50_ms=float(p50),
            p95_ms=float(p95),
            p99_ms=float(p99),
            limit_ms=LIMITS_MS.get(name),
            limit_p99_ms=LIMITS_P99_MS.get(name),
        )


@dataclass(frozen=True, kw_only=True)
class BenchResult:
    """All that was measured, and on what."""

    machine: Mapping[str, Any]
    """As `describe_machine` returned it before the measurement."""
    stages: tuple[Stage, ...]
    rows: tuple[RowResult, ...]
    """Steps, resets, episodes and the like, and those of the other checkout where there was one."""
    fetch: Mapping[str, Any] | None
    """As `compare_with_fetch` returned it, if it was asked for."""

    @property
    def episodes(self) -> list[dict[str, Any]]:
        """Summaries of the whole episodes of the first fidelity."""
        first = next(result for result in self.rows if result.row.measure == "episodes")
        return [sample["summary"] for sample in first.samples]

    @property
    def against(self) -> dict[str, Any] | None:
        """The ratios of this checkout to the other, if there was one, as `row_ratios` returns them."""
        return {"machine": dict(self.machine), **row_ratios(self.rows)} if self.rows[0].others else None

    def as_dict(self) -> dict[str, Any]:
        """Return plain data.

        `machine`, `stages`, `loop` (real-time factor, median time of each stage) and `episodes`, both of the first fidelity,
        and whatever `row_medians` returns.
        """
        factors = [episode["real_time_factor"] for episode in self.episodes]
        return {
            **row_medians(self.rows),
            "machine": dict(self.machine),
            "stages": [asdict(stage) for stage in self.stages],
            "loop": {
                "real_time_factor": {"median": float(np.median(factors)), "min": min(factors), "max": max(factors)},
                "limit_real_time_factor": LIMIT_REAL_TIME_FACTOR,
                "stage_ms": {
                    stage: float(np.median([episode["stage_ms"][stage] for episode in self.episodes]))
                    for stage in self.episodes[0]["stage_ms"]
                },
            },
            "episodes": self.episodes,
        }


def as_csv(result: BenchResult) -> str:
    """Write the stages as CSV."""
    return csv_text([item.name for item in fields(Stage)], map(astuple, result.stages))


def as_markdown(result: BenchResult) -> str:
    """Write machine, stages and loop as Markdown."""
    machine = result.machine
    lines = [
        (
            f"Measured on {machine['cpu']}, {machine['usable_cores']} cores, {machine['memory_gib']} GiB, "
            f"{machine['system']}; load before the measurement {machine['load_1min']}."
        ),
        "",
        "| stage | calls | 5 % [ms] | median [ms] | 95 % [ms] | 99 % [ms] | target of the median [ms] | of the 99 % [ms] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for stage in result.stages:
        numbers = " | ".join(f"{value:.3f}" for value in (stage.p5_ms, stage.p50_ms, stage.p95_ms, stage.p99_ms))
        targets = " | ".join("" if limit is None else f"{limit:g}" for limit in (stage.limit_ms, stage.limit_p99_ms))
        lines.append(f"| {stage.name} | {stage.calls} | {numbers} | {targets} |")
    loop = result.as_dict()["loop"]
    factor = loop["real_time_factor"]
    lines += [
        "",
        (
            f"The whole loop runs at {factor['median']:.2f} of real time without a recording ({factor['min']:.2f} to "
            f"{factor['max']:.2f} in {len(result.episodes)} episodes; target: {LIMIT_REAL_TIME_FACTOR:g})."
        ),
    ]
    text = "\n".join([*lines, "", rows_markdown(result.rows)])
    if result.against is not None:
        text += f"\nIn turns with another checkout:\n\n{ratios_markdown(result.rows)}"
    return text + ("" if result.fetch is None else f"\n{fetch_sentence(result.fetch)}\n")
