"""Rows as nested plain data and as Markdown."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from laploop.studies.timing.interleaving import Spread
from laploop.studies.timing.rows import RowResult


def nested(values: Mapping[tuple[str, ...], Any]) -> dict[str, Any]:
    """Return a tree of dictionaries from its leaves by path."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        branch = tree
        for key in path[:-1]:
            branch = branch.setdefault(key, {})
        branch[path[-1]] = value
    return tree


def row_medians(results: Sequence[RowResult]) -> dict[str, Any]:
    """Return the median of every row under its path, quartiles under `spread`, and where a step's time goes under `step_ms`.

    `step_ms` > fidelity > observation > stage adds up to the mean wall-clock time of a step; `background_ms` holds what passes
    beside it, on other threads.
    """
    spreads = {result.row.path: Spread.of(result.values) for result in results}
    leaves: dict[tuple[str, ...], Any] = {path: spread.median for path, spread in spreads.items()}
    leaves |= {("spread", *path): spread.as_dict() for path, spread in spreads.items()}
    for result in results:
        if result.row.measure == "steps":
            place = result.row.path[1:3]
            for key, source in (("step_ms", "stage_ms"), ("background_ms", "background_ms")):
                # Means, since medians of parts do not add up to the whole.
                leaves |= {(key, *place, stage): value for stage, value in _means(result, source).items()}
    return nested(leaves)


def row_ratios(results: Sequence[RowResult]) -> dict[str, Any]:
    """Return for every row under its path both medians and the ratio, this over the other, with its quartiles."""
    leaves: dict[tuple[str, ...], Any] = {}
    for result in results:
        ratio = Spread.of_ratio(result.values, result.other_values)
        leaves[result.row.path] = {
            "this": float(np.median(result.values)),
            "other": float(np.median(result.other_values)),
            "ratio": ratio.median,
            "p25": ratio.p25,
            "p75": ratio.p75,
            "rounds": ratio.rounds,
            "unit": result.row.unit,
            "better": "more" if result.row.rate else "less",
            "other_fidelity": result.other_fidelity,
        }
    return nested(leaves)


def rows_markdown(results: Sequence[RowResult]) -> str:
    """Write the rows as Markdown, and below them where the time of a step goes."""
    lines = ["| row | median | quartiles | unit | rounds |", "|---|---|---|---|---|"]
    for result in results:
        spread = Spread.of(result.values)
        quartiles = f"{_short(spread.p25)} to {_short(spread.p75)}"
        lines.append(f"| {result.row.name} | {_short(spread.median)} | {quartiles} | {result.row.unit} | {spread.rounds} |")
    steps = {result.row.path[1:3]: _means(result, "stage_ms") for result in results if result.row.measure == "steps"}
    stages = sorted({stage for each in steps.values() for stage in each}, key=lambda stage: (stage == "other", stage))
    if steps:
        lines += ["", "Where the time of a step (40 ms of the world) goes, in milliseconds of the main thread:", ""]
        lines += [f"| step | {' | '.join(stages)} | whole |", "|---|" + "---|" * (len(stages) + 1)]
        for (fidelity, observation), each in steps.items():
            cells = " | ".join(_short(each[stage]) if stage in each else "" for stage in stages)
            lines.append(f"| {fidelity}, {observation} | {cells} | {_short(sum(each.values()))} |")
    return "\n".join(lines) + "\n"


def ratios_markdown(results: Sequence[RowResult]) -> str:
    """Write the ratios as Markdown."""
    lines = ["| row | this | other | this over other | quartiles | better | rounds |", "|---|---|---|---|---|---|---|"]
    for result in results:
        ratio = Spread.of_ratio(result.values, result.other_values)
        ours, others = (_short(float(np.median(values))) for values in (result.values, result.other_values))
        fidelity = result.row.options.get("fidelity", "")
        others += "" if result.other_fidelity == fidelity else f" ({result.other_fidelity})"
        quartiles, better = f"{ratio.p25:.2f} to {ratio.p75:.2f}", "more" if result.row.rate else "less"
        lines.append(
            f"| {result.row.name} [{result.row.unit}] | {ours} | {others} | {ratio.median:.2f} | {quartiles} | {better} "
            f"| {ratio.rounds} |"
        )
    return "\n".join(lines) + "\n"


def _means(result: RowResult, source: str) -> dict[str, float]:
    """Return the mean of each stage over the rounds."""
    stages = dict.fromkeys(stage for sample in result.samples for stage in sample[source])
    return {stage: float(np.mean([sample[source].get(stage, 0.0) for sample in result.samples])) for stage in stages}


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
