"""Tables of depth and confidence on anatomy, of the loop on it, and of light that the stripe camera leaves out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from laploop.assets.scope_optics import ScopeOptics
from laploop.perception.geometry import Rig
from laploop.perception.reliability import TENTHS
from laploop.studies.readme.results_tables import shown

_MODELS = ("phase", "compact", "ssle-phase")
"""Of the tables of anatomy, in their order."""

_DATA_SETS = {"frames": "held-out tissues", "worlds": "known families", "held-out": "held-out families"}
"""What folders of frames hold."""

_ORGAN_ERRORS = {"track": "normal_rms_mm", "scan": "standoff_rms_mm"}
"""What counts as a task's error on organs; the final one elsewhere."""

_SAME_PIXELS = "Where `phase` is valid, all estimators are measured on the same pixels, whatever they mark."


def anatomy_table(known: Mapping[str, Any], held_out: Mapping[str, Any]) -> str:
    """Return the table of families for two evaluations: of families that were learned from, and of others.

    Columns of measures that neither has are left out.
    """
    named = [(kind, name, row) for kind, summary in _sets(known, held_out) for name, row in _named(summary)]
    named = [(kind, name, row) for kind, name, row in named if row["against"] == "exact" and row["model"] in _MODELS]
    columns = [column for column in _COLUMNS if any(row.get(column.name) is not None for _, _, row in named)]
    lines = [
        "Anatomy at 60 to 140 mm ([worlds](../depth.md#worlds)); no weights learned from, or were chosen by, the families and",
        "textures that are held out. Lit pixels are those that the projector reaches; a slip is a valid pixel that is more",
        "than a tenth off.",
        *([_SAME_PIXELS] if any(column.name == "phase_valid_mae_mm" for column in columns) else []),
        "",
        f"| estimator | set | shape or texture | frames | {' | '.join(column.head for column in columns)} |",
        "|" + "---|" * (4 + len(columns)),
    ]
    for model in _MODELS:
        lines += [
            f"| {shown(model)} | {kind} | {name} | {row['frames']} | {' | '.join(column.cell(row) for column in columns)} |"
            for kind, name, row in named
            if row["model"] == model
        ]
    return "\n".join(lines)


def confidence_table(known: Mapping[str, Any], held_out: Mapping[str, Any]) -> str | None:
    """Return how the confidences of two evaluations fit what is seen, over all families; None where neither has any."""
    rows = [
        (kind, row)
        for kind, summary in _sets(known, held_out)
        for row in summary.get("reliability", ())
        # Files from before there were rows for families have no such field.
        if row["against"] == "exact" and row.get("family", "all") == "all" and row["aurc_mm"] is not None
    ]
    if not rows:
        return None
    tenths = [f"{10 * tenth}-{10 * tenth + 10} %" for tenth in range(TENTHS)]
    heads = ["estimator", "set", "calibration error", "AURC", *tenths, "largest difference"]
    lines = [
        "The confidence is the predicted probability of being within 1 mm. For each tenth of it, over all pixels in the range",
        "of depth: its mean and the rate that is seen, and last the largest difference of the two. The calibration error is",
        "their mean difference over all pixels; AURC is the area under the error of the pixels admitted by falling confidence.",
        *(["In brackets 95 % intervals over scenes."] if any(row.get("aurc_mm_low") is not None for _, row in rows) else []),
        "",
        f"| {' | '.join(heads)} |",
        "|" + "---|" * len(heads),
    ]
    for model in _MODELS:
        lines += [
            f"| {shown(model)} | {kind} | {' | '.join(_confidence_cells(row))} |" for kind, row in rows if row["model"] == model
        ]
    return "\n".join(lines)


def slip_table(known: Mapping[str, Any], held_out: Mapping[str, Any]) -> str | None:
    """Return predicted and seen slips of two evaluations, over all families; None where neither tells them."""
    rows = [
        (kind, row["model"], row["slips"])
        for kind, summary in _sets(known, held_out)
        for row in summary.get("reliability", ())
        if row["against"] == "exact" and row.get("family", "all") == "all" and row.get("slips") is not None
    ]
    if not rows:
        return None
    edges = [f"{1e3 * edge:g}" for edge in rows[0][2]["edges"]]
    heads = ["estimator", "set", "all pixels", "valid pixels", *(f"{low}-{high}" for low, high in pairwise(edges))]
    lines = [
        "Predicted and seen slips, per 1000 pixels: depth more than a tenth off, or of a pixel whose true depth is not 60 to",
        "140 mm; over all pixels of known depth, over those marked valid, and by the number that is predicted. In brackets the",
        "95 % interval over scenes of what is seen.",
        "",
        f"| {' | '.join(heads)} |",
        "|" + "---|" * len(heads),
    ]
    for name in _MODELS:
        for kind, slips in ((kind, slips) for kind, model, slips in rows if model == name):
            cells = [_foreseen(part) for part in (slips["all"], slips["valid"], *slips["bins"])]
            lines.append(f"| {shown(name)} | {kind} | {' | '.join(cells)} |")
    return "\n".join(lines)


def organs_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of the closed loop on organs, from summaries of `laploop trials --phantom`."""
    lines = [
        "The closed loop with `compact` on organs, bodies of closed meshes, which breathe but for the scan. Of a reach, the",
        "distance from an ideal touch at its end, of track, the RMS error along the normal, of a scan, that of the stand-off:",
        "mean and worst episode. Force is the worst of all physics steps of all episodes. A scan follows a line of 60 mm where",
        "the organ has room for it, of 30 mm or more elsewhere: its mean length.",
        "",
        "| organ | task | episodes | success (95 %) | error mean | error worst | force worst | line |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for summary in summaries:
        organ = Path(summary["config"]["episode"]["task"]["loop"]["theatre"]["tissue"]["mesh"]).stem
        metrics, name = summary["metrics"], _ORGAN_ERRORS.get(summary["task"])
        error = summary["final_error_mm"] if name is None else metrics[name]
        line = f"{metrics['path_length_mm']['mean']:.0f} mm" if "path_length_mm" in metrics else ""
        low, high = summary["success_interval_95"]
        lines.append(
            f"| {organ} | {summary['task']} | {summary['episodes']} | {100 * summary['success_rate']:.0f} % "
            f"({100 * low:.0f}-{100 * high:.0f}) | {error['mean']:.2f} mm | {error['max']:.2f} mm | "
            f"{summary['contact_force_n']['max']:.2f} N | {line} |"
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


def blur_table(blur: Mapping[str, Any]) -> str:
    """Return the error of exact depth that is blurred, by data set."""
    rig = Rig.from_optics(ScopeOptics())
    heads = [f"{sigma_px:g} px" for sigma_px in blur["sigma_px"]]
    lines = [
        "What exact depth is off by on the lit pixels once it is blurred, by the standard deviation of the Gaussian. It is a",
        "yardstick and no bound: whoever keeps edges sharp is better than a blur. A period of the nominal stripes is",
        f"{rig.mask.period_tan * rig.camera.fx:.1f} pixels wide.",
        "",
        f"| data set | frames | {' | '.join(heads)} |",
        "|" + "---|" * (2 + len(heads)),
    ]
    for name, found in blur["sets"].items():
        errors = " | ".join(f"{error:.2f} mm" for error in found["mae_mm"])
        lines.append(f"| {_DATA_SETS.get(name, name)} | {found['frames']} | {errors} |")
    return "\n".join(lines)


def _sets(known: Mapping[str, Any], held_out: Mapping[str, Any]) -> tuple[tuple[str, Mapping[str, Any]], ...]:
    return ("known", known), ("held out", held_out)


@dataclass(frozen=True, kw_only=True)
class _Column:
    """A measure in the table of anatomy."""

    head: str
    name: str
    """Of the field."""
    unit: str
    scale: float = 1.0
    digits: int = 2
    nothing: str = ""
    """What stands for an unknown value."""

    def cell(self, row: Mapping[str, Any]) -> str:
        """Return what the table says of a row."""
        value = row.get(self.name)
        return self.nothing if value is None else f"{self.scale * value:.{self.digits}f}{self.unit}"


_COLUMNS = (
    _Column(head="MAE, lit pixels", name="lit_mae_mm", unit=" mm"),
    _Column(head="valid", name="valid_share", unit=" %", scale=100.0, digits=0),
    _Column(head="valid, of lit", name="lit_valid_share", unit=" %", scale=100.0, digits=0),
    _Column(head="MAE, valid pixels", name="valid_mae_mm", unit=" mm"),
    _Column(head="MAE where `phase` is valid", name="phase_valid_mae_mm", unit=" mm"),
    _Column(head="slips, per 1000", name="valid_slips_per_1000", unit="", digits=1, nothing="none"),
)


def _confidence_cells(row: Mapping[str, Any]) -> list[str]:
    pairs = [(tenth["predicted"], tenth["seen"]) for tenth in row["tenths"]]
    known = [(predicted, seen) for predicted, seen in pairs if predicted is not None]
    return [
        _with_ends(row, "calibration_error", 100.0, ".1f", " %"),
        _with_ends(row, "aurc_mm", 1.0, ".2f", " mm"),
        *("" if predicted is None else f"{100 * predicted:.0f} / {100 * seen:.0f} %" for predicted, seen in pairs),
        f"{100 * max(abs(predicted - seen) for predicted, seen in known):.1f} %",
    ]


def _foreseen(part: Mapping[str, Any]) -> str:
    if part["predicted"] is None:
        return ""
    low, high = (part.get(f"seen_{end}") for end in ("low", "high"))
    ends = "" if low is None or high is None else f" ({1e3 * low:.1f} to {1e3 * high:.1f})"
    return f"{1e3 * part['predicted']:.1f} / {1e3 * part['seen']:.1f}{ends}"


def _with_ends(row: Mapping[str, Any], name: str, scale: float, digits: str, unit: str) -> str:
    low, high = (row.get(f"{name}{end}") for end in ("_low", "_high"))
    ends = "" if low is None or high is None else f" ({scale * low:{digits}} to {scale * high:{digits}})"
    return f"{scale * row[name]:{digits}}{unit}{ends}"
