"""Tables of the page of results that come from `laploop bench`."""

from collections.abc import Iterator, Mapping
from typing import Any

_ROWS = {
    "env_steps_per_s": "steps of 40 ms a second",
    "real_time_factor": "of real time",
    "physics_ms": "ms of CPU time for 40 ms of the world",
    "capture_ms": "ms of CPU time a picture",
    "reset_ms": "ms",
    "reset_state_ms": "ms",
    "memory_mb": "MB",
}
"""Quantities of the bench and their units, in the order of the table."""


def bench_rows_table(summary: Mapping[str, Any]) -> str | None:
    """Return the medians of steps, physics, resets and memory by fidelity; None for a bench that has none."""
    lines = ["| measured | `full` | `fast` | |", "|---|---|---|---|"]
    for quantity, unit in _ROWS.items():
        by_fidelity = {name: dict(_leaves(found)) for name, found in summary.get(quantity, {}).items()}
        for path in by_fidelity.get("full", {}):
            found = (by_fidelity.get(name, {}).get(path) for name in ("full", "fast"))
            cells = ["" if value is None else _short(value) for value in found]
            lines.append(f"| {' '.join((quantity, *path)).strip()} | {' | '.join(cells)} | {unit} |")
    return "\n".join(lines) if len(lines) > 2 else None


def against_table(summary: Mapping[str, Any]) -> str:
    """Return the ratios to another checkout, measured in turns."""
    lines = [
        "Measured in turns with the revision before this one on the same machine, this one's number over that one's, median",
        "and quartiles; that one knows no `fast` and runs as `full` in both columns.",
        "",
        "| measured | `full` over before | `fast` over before | better |",
        "|---|---|---|---|",
    ]
    for quantity in _ROWS:
        by_fidelity = {name: dict(_ratios(found)) for name, found in summary.get(quantity, {}).items()}
        for path in by_fidelity.get("full", {}):
            found = [by_fidelity.get(name, {}).get(path) for name in ("full", "fast")]
            cells = ["" if one is None else f"{one['ratio']:.2f} ({one['p25']:.2f} to {one['p75']:.2f})" for one in found]
            better = next(one["better"] for one in found if one is not None)
            lines.append(f"| {' '.join((quantity, *path)).strip()} | {' | '.join(cells)} | {better} |")
    return "\n".join(lines)


def dense_kernels_table(summary: Mapping[str, Any]) -> str:
    """Return what each file of kernels gains by loops in C++ that compute several pixels at once."""
    step, picture = summary["step_cpu_ms"]["median"], summary["picture_cpu_ms"]["median"]
    lines = [
        "Some loops over pixels are written in C++ so that the compiler computes several pixels at once. What they save of the",
        f"{picture:.1f} ms of CPU time of a picture on one thread, median and quartiles, and of the {step:.0f} ms of a step in",
        "`full` with `compact`:",
        "",
        "| kernels | saved | of a step |",
        "|---|---|---|",
    ]
    for name, found in summary["files"].items():
        saved, share = found["saved_ms"], 100 * found["share_of_step"]
        spread = f"{saved['median']:.2f} ms ({saved['p25']:.2f} to {saved['p75']:.2f})"
        lines.append(f"| `{name}` | {spread} | {share:.1f} % |")
    return "\n".join(lines)


def _leaves(tree: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], float]]:
    if not isinstance(tree, Mapping):
        yield path, float(tree)
        return
    for key, branch in tree.items():
        yield from _leaves(branch, path if key == "single" else (*path, key))


def _ratios(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Mapping[str, Any]]]:
    if "ratio" in tree:
        yield path, tree
        return
    for key, branch in tree.items():
        yield from _ratios(branch, path if key == "single" else (*path, key))


def _short(value: float) -> str:
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
