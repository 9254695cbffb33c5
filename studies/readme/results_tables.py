"""Tables of the README's results whose summaries need not be there."""

from collections.abc import Mapping, Sequence
from typing import Any

from laploop.studies.episodes.task_campaigns import COLLISIONS, FORCE, LIMITS, TROCAR
from laploop.studies.episodes.task_table import MET, quantity


def tasks_table(summary: Mapping[str, Any]) -> str:
    """Return a line for each campaign of `laploop tasks`: its own numbers with their targets, and those that all have."""
    episodes = " or ".join(map(str, sorted({line["episodes"] for line in summary["campaigns"]})))
    heads = (
        "task",
        "estimator, tissue, arm",
        "success (95 %)",
        "measured (target)",
        "trocar error",
        "force",
        "collisions",
        "limits",
    )
    lines = [
        f"The five tasks, {episodes} episodes a line, one tissue each. Over all physics steps of all episodes: the worst",
        "trocar error of both arms, the worst force on the tip, and the largest fraction of its limits of angle, speed and",
        "acceleration that any joint used.",
        "",
        f"| {' | '.join(heads)} | meets its targets |",
        "|" + "---|" * (len(heads) + 1),
    ]
    for line in summary["campaigns"]:
        low, high = line["success_interval_95"]
        own, common = line["checks"][: line["own_checks"]], line["checks"][line["own_checks"] :]
        by_name = {check["name"]: check for check in common}
        measured = "; ".join(_measured(check) for check in own if check["name"] != "success")
        how = ", ".join(
            [f"`{line['perception']}`", line["motion"], line["actuation"]]
            + ([] if line["prediction"] is None else [f"prediction {line['prediction']}"])
        )
        lines.append(
            f"| {line['task']} | {how} | {100 * line['success_rate']:.0f} % ({100 * low:.0f}-{100 * high:.0f}) | {measured} | "
            f"{quantity(by_name[TROCAR])} | {quantity(by_name[FORCE])} | "
            f"{quantity(by_name[COLLISIONS])} | "
            f"{_percent(by_name[LIMITS]['value'])} | {MET[line['met']]} |"
        )
    return "\n".join(lines)


def fast_tasks_table(fast: Mapping[str, Any], full: Mapping[str, Any]) -> str:
    """Return what `fast` does to the campaigns of `laploop tasks`: success, own numbers, force, beside those in `full`."""
    lines = [
        "The same episodes with the fidelity `fast`, which is made for learning; the targets are those of `full`, whose",
        "numbers are in brackets.",
        "",
        "| task | estimator, prediction | success | measured | force | meets its targets |",
        "|---|---|---|---|---|---|",
    ]
    full_lines = {line["campaign"]: line for line in full["campaigns"]}
    for line in fast["campaigns"]:
        before = full_lines[line["campaign"]]
        checks = {check["name"]: check for check in before["checks"]}
        own = [check for check in line["checks"][: line["own_checks"]] if check["name"] != "success"]
        force = next(check for check in line["checks"] if check["name"] == FORCE)
        measured = "; ".join(f"{check['name']} {quantity(check)} ({quantity(checks[check['name']])})" for check in own)
        how = f"`{line['perception']}`" + ("" if line["prediction"] is None else f", {line['prediction']}")
        lines.append(
            f"| {line['task']} | {how} | {100 * line['success_rate']:.0f} % ({100 * before['success_rate']:.0f}) | "
            f"{measured} | {quantity(force)} ({quantity(checks[FORCE])}) | {MET[line['met']]} |"
        )
    return "\n".join(lines)


def residual_table(summary: Mapping[str, Any], calibrated: Mapping[str, Any]) -> str:
    """Return what an error put into the calibration does to the errors against the reference camera.

    `calibrated` is the summary of the same evaluation without the error.
    """
    config = summary["config"]["evaluation"]
    before, after = overall(calibrated, "zivid"), overall(summary, "zivid")
    exact = overall(summary, "exact-at-zivid")
    lines = [
        f"The same with an error of {config['residual_mm']:g} mm and {config['residual_deg']:g} degrees put into the transform",
        "between the two cameras, in directions that a seed draws: how much of a depth error is the reference's.",
        "",
        "| model | MAE as calibrated | MAE with the error | AbsRel | Acc(1.1) | Acc(1.1²) | MAE against exact depth |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {shown(model)} | {_mm(before.get(model))} | {_mm(row)} | {row['abs_rel']:.4f} | {row['acc_1_1']:.4f} | "
        f"{row['acc_1_21']:.4f} | {_mm(exact.get(model))} |"
        for model, row in after.items()
    ]
    if "reference" in exact:
        lines.append(f"| the reference camera itself | | | | | | {_mm(exact['reference'])} |")
    return "\n".join(lines)


def robustness_table(summary: Mapping[str, Any]) -> str:
    """Return what becomes of the models under other conditions than the nominal one."""
    rows = summary["robustness"]
    lines = [
        f"Conditions beside the nominal one, {rows[0]['frames']} frames each on tissues of no data set, against exact",
        "depth: over all pixels, over those the projector reaches, and over those the model marks valid, within the range",
        "of depth and, in the last column, at any depth. Ratios are to the nominal condition, and to the nominal frame on the",
        "same pixels: an instrument hides the middle of the view, where depth is easiest. `compact` and `ssle-phase` learned",
        "from the same frames, on other tissues; shifted stripes, light down to 0.3 of the nominal, large instruments and bad",
        "exposure are among them. The last rows are not a model: they take exact depth wherever the projector reaches and",
        "continue it smoothly elsewhere, which shows what the unlit part of a view costs by itself.",
        "",
        "| model | condition | MAE, all | to nominal | MAE, lit | to nominal | same pixels | valid | MAE, valid | any depth |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {shown(row['model'])} | {row['condition']} | {_mm(row)} | {_figure(row['ratio'])} | {_mm(row, 'lit_mae_mm')} | "
        f"{_figure(row['lit_ratio'])} | {_figure(row['same_ratio'])} | {_percent(row['valid_share'])} | "
        f"{_mm(row, 'valid_mae_mm')} | {_mm(row, 'valid_any_depth_mae_mm')} |"
        for row in rows
    ]
    return "\n".join(lines)


def speed_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return how long the models take for a frame."""
    lines = [
        "Time of a frame, from image array to depth array, one after another:",
        "",
        "| model | how | frames | median | 99 % | slowest | frequency | on |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for summary in summaries:
        config, machine = summary["config"]["speed"], summary["machine"]
        how = " ".join(part for part in (summary["backend"], summary["precision"]) if part)
        threads = f", {config['threads']} used" if config["threads"] else ""
        where = f"{machine['usable_cores']} cores{threads}, {machine['cpu']}" if config["device"] == "cpu" else machine["gpu"]
        lines.append(
            f"| {shown(config['model'])} | {how} | {config['frames']} | {summary['p50_ms']:.1f} ms | "
            f"{summary['p99_ms']:.1f} ms | {summary['max_ms']:.1f} ms | {summary['hz']:.1f} Hz | {where} |"
        )
    return "\n".join(lines)


def _measured(check: Mapping[str, Any]) -> str:
    bar = f" ({check['bar']})" if check["bar"] else ""
    return f"{check['name']} {quantity(check)}{bar}"


def overall(summary: Mapping[str, Any], against: str) -> dict[str, Mapping[str, Any]]:
    """Return the rows of a depth evaluation over all distances, by model."""
    rows = (row for row in summary["rows"] if row["working_distance_mm"] == "all" and row["against"] == against)
    return {row["model"]: row for row in rows}


def shown(model: str) -> str:
    """Return a model's name as Markdown: as code where it is a name, plain where it is words."""
    return model if " " in model else f"`{model}`"


def _mm(row: Mapping[str, Any] | None, column: str = "mae_mm") -> str:
    return "" if row is None or row[column] is None else f"{row[column]:.2f} mm"


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{100 * value:.0f} %"
