"""Tables of depth on anatomy, of the loop on it, and of light that the stripe camera leaves out."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from laploop.studies.readme.results_tables import shown


def anatomy_table(known: Mapping[str, Any], held_out: Mapping[str, Any]) -> str:
    """Return the table of families for two evaluations: of families that were learned from, and of others."""
    lines = [
        "Anatomy at 60 to 140 mm ([worlds](../depth.md#worlds)); no weights learned from, or were chosen by, the families and",
        "textures that are held out. Lit pixels are those that the projector reaches; a slip is a valid pixel that is more",
        "than a tenth off.",
        "",
        "| estimator | set | shape or texture | frames | MAE, lit pixels | valid | MAE, valid pixels | slips, per 1000 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for model in ("phase", "compact", "ssle-phase"):
        for kind, summary in (("known", known), ("held out", held_out)):
            lines += [
                f"| {shown(model)} | {kind} | {name} | {_cells(row)} |"
                for name, row in _named(summary)
                if row["model"] == model and row["against"] == "exact"
            ]
    return "\n".join(lines)


def organs_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the closed loop on organs, from summaries of `laploop trials --phantom`."""
    lines = [
        "The closed loop with `compact` on organs that breathe, bodies of closed meshes. Of a reach, the distance from an",
        "ideal touch at its end, of track, the RMS error along the normal: mean and worst episode. Force is the worst of all",
        "physics steps of all episodes.",
        "",
        "| organ | task | episodes | success (95 %) | error mean | error worst | force worst |",
        "|---|---|---|---|---|---|---|",
    ]
    for summary in summaries:
        organ = Path(summary["config"]["episode"]["task"]["loop"]["theatre"]["tissue"]["mesh"]).stem
        error = summary["metrics"]["normal_rms_mm"] if summary["task"] == "track" else summary["final_error_mm"]
        low, high = summary["success_interval_95"]
        lines.append(
            f"| {organ} | {summary['task']} | {summary['episodes']} | {100 * summary['success_rate']:.0f} % "
            f"({100 * low:.0f}-{100 * high:.0f}) | {error['mean']:.2f} mm | {error['max']:.2f} mm | "
            f"{summary['contact_force_n']['max']:.2f} N |"
        )
    return "\n".join(lines)


def light_table(summary: Mapping[str, Any]) -> str:
    """Return the table of the networks under the path tracer's light, from the summary of `laploop twin`."""
    rows: dict[str, dict[str, Mapping[str, Any]]] = {}
    for row in summary["light"]:
        rows.setdefault(row["light"], {})[row["model"]] = row
    models = list(next(iter(rows.values())))
    lines = [
        "Organs before a wall, rendered by the path tracer with one thing changed at a time; error over the lit pixels, and",
        "its ratio to that on the stripe camera's own images of the same organs under nominal light.",
        "",
        "| light | " + " | ".join(f"{shown(model)} | ratio" for model in models) + " |",
        "|---|" + "---|---|" * len(models),
    ]
    for light, found in rows.items():
        cells = " | ".join(f"{found[model]['mae_mm']:.2f} mm | {found[model]['ratio']:.2f}" for model in models)
        lines.append(f"| {light} | {cells} |")
    return "\n".join(lines)


def _named(summary: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the lines of families, textures and all frames, with what the table calls them."""
    for row in summary["families"]:
        yield row["family"], row
    for row in summary["textures"]:
        yield f"texture {row['texture']}", row
    yield from (("all", row) for row in summary["rows"] if row["working_distance_mm"] == "all")


def _cells(row: Mapping[str, Any]) -> str:
    slips = row["valid_slips_per_1000"]
    return (
        f"{row['frames']} | {row['lit_mae_mm']:.2f} mm | {100 * row['valid_share']:.0f} % | {row['valid_mae_mm']:.2f} mm | "
        f"{'none' if slips is None else f'{slips:.1f}'}"
    )
