"""The page of results and the short tables in the README, made from the committed summaries of the commands that measured them.

`python -P -m laploop.studies.readme.results_page docs/results README.md` rewrites both; a test checks that they are up to date.
"""

import sys
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from laploop.errors import InvalidValueError, OutputError
from laploop.perception.network_specs import SHIPPED
from laploop.studies.fidelity.run import as_markdown
from laploop.studies.readme.anatomy_tables import (
    anatomy_table,
    blur_table,
    confidence_table,
    light_table,
    organs_table,
    slip_table,
)
from laploop.studies.readme.bench_tables import against_table, bench_rows_table, dense_kernels_table
from laploop.studies.readme.readme_tables import summary_markdown
from laploop.studies.readme.results_tables import (
    fast_tasks_table,
    overall,
    residual_table,
    robustness_table,
    shown,
    speed_table,
    tasks_table,
)
from laploop.studies.readme.summaries import read_summary

BEGIN = "<!-- results: begin -->"
END = "<!-- results: end -->"

DEPTH = Path(str(files("laploop.assets") / "weights" / "compact.json"))
"""The depth evaluation that the shipped weights' card rests on."""

MODELS = ("oracle", *(spec.name for spec in SHIPPED), "phase")
"""In the order of the tables."""

TRIALS = tuple(f"{name}-{motion}" for name in MODELS for motion in ("still", "breathing"))
"""Closed-loop studies, in the order of the table: estimator and motion; those without a file are left out."""


def results_markdown(folder: Path) -> str:
    """Return the page of results for the summaries in `folder`.

    Those of trials, tasks, organs, anatomy and the confidence and slips on it, blur, the path tracer, robustness, speed,
    fidelity, of another revision, of dense kernels and of an injected calibration error are left out where they are missing.

    Raises:
        MissingFileError: If the folder lacks one of the others.
    """
    pairs = read_summary(folder / "depth-pairs.json")
    trials = [read_summary(path) for name in TRIALS if (path := folder / f"trials-{name}.json").is_file()]
    organs = [read_summary(path) for path in sorted(folder.glob("organs-*.json"))]
    speeds = [read_summary(path) for name in MODELS if (path := folder / f"speed-{name}.json").is_file()]
    tasks, fast, residual, robustness, fidelity, against, kernels, known, held_out, twin, blur = (
        read_summary(path) if (path := folder / f"{name}.json").is_file() else None
        for name in (
            "tasks",
            "tasks-fast",
            "depth-pairs-residual",
            "robustness",
            "fidelity",
            "against",
            "dense-kernels",
            "depth-worlds",
            "depth-held-out",
            "twin",
            "depth-blur",
        )
    )
    sensor = (read_summary(folder / f"{name}.json") for name in ("characterization", "calibration", "collection"))
    sections = {
        "Closed loop": _trials_table(trials),
        "Tasks": tasks_table(tasks) if tasks else None,
        "Tasks in `fast`": fast_tasks_table(fast, tasks) if fast and tasks else None,
        "On organs": organs_table(organs) if organs else None,
        "Depth against exact truth": _depth_table(robustness or read_summary(DEPTH)),
        "Depth on anatomy": anatomy_table(known, held_out) if known and held_out else None,
        "Confidence on anatomy": confidence_table(known, held_out) if known and held_out else None,
        "Slips on anatomy": slip_table(known, held_out) if known and held_out else None,
        "What blur alone costs": blur_table(blur) if blur else None,
        "Depth under the path tracer's light": light_table(twin) if twin else None,
        "Depth against the reference camera": _pairs_table(pairs),
        "What an error of the calibration costs": residual_table(residual, pairs) if residual else None,
        "Depth under other conditions": robustness_table(robustness) if robustness else None,
        "Sensor, calibration, data": _sensor_paragraph(*sensor),
        "Speed of the depth networks": speed_table(speeds) if speeds else None,
        "What `fast` changes": as_markdown(fidelity).rstrip() if fidelity else None,
        "Time of each stage": _bench_table(read_summary(folder / "bench.json")),
        "Steps, resets and memory": bench_rows_table(read_summary(folder / "bench.json")),
        "Against the revision before": against_table(against) if against else None,
        "Dense code": dense_kernels_table(kernels) if kernels else None,
    }
    return _HEADER + "\n".join(f"\n## {title}\n\n{text}\n" for title, text in sections.items() if text is not None)


_HEADER = """# Results

Everything here comes from the summaries beside this page. `make results` measures them anew, which takes a few hours on two
cores, and writes the page.
"""


def with_results(readme: str, block: str) -> str:
    """Return the text of the README with its results block replaced.

    Raises:
        InvalidValueError: If the markers of the block are missing.
    """
    if readme.count(BEGIN) != 1 or readme.count(END) != 1:
        raise InvalidValueError("README", "markers missing", f"one {BEGIN} and one {END}")
    before, rest = readme.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n{block}\n{END}{after}"


def main(arguments: Sequence[str]) -> None:
    """Rewrite page and tables: `arguments` are the folder of results and the README."""
    folder, readme = (Path(argument) for argument in arguments)
    _write(folder / "README.md", results_markdown(folder))
    _write(readme, with_results(readme.read_text(encoding="utf-8"), summary_markdown(folder)))


def _write(page: Path, text: str) -> None:
    partial = page.with_suffix(".partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(page)
    except OSError as error:
        raise OutputError(f"cannot write {page}: {error.strerror}") from error


def _trials_table(summaries: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "Touch a chosen point, one tissue a seed, 40 ms of perception latency. The error is the distance from an",
        "ideal touch at the end of the episode; force and trocar error are the worst of all physics steps of all episodes.",
        "",
        "| estimator | tissue | episodes | success | error mean | error worst | force worst | trocar error worst |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for summary in summaries:
        error, rcm = summary["final_error_mm"], summary["rcm_error_mm"]
        lines.append(
            f"| `{summary['perception']}` | {summary['motion']} | {summary['episodes']} | "
            f"{100 * summary['success_rate']:.0f} % | {error['mean']:.2f} mm | "
            f"{error['max']:.2f} mm | {summary['contact_force_n']['max']:.2f} N | "
            f"{max(rcm.values()):.3f} mm |"
        )
    return "\n".join(lines)


def _depth_table(summary: Mapping[str, Any]) -> str:
    lines = [
        f"Depth of {summary['frames']} frames of {summary['tissues']} tissues that no training saw, 60 to 140 mm, against",
        "exact truth; first over the pixels the estimator marks valid, then over all. The photon floor is the smallest error",
        "that the sensor's noise permits from one period of the stripes, where they can be read.",
        "",
        "| estimator | valid pixels | MAE | AbsRel | within 10 % | MAE, all pixels |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {shown(model)} | {100 * row['valid_share']:.1f} % | {row['valid_mae_mm']:.2f} mm | "
        f"{row['valid_abs_rel']:.4f} | {100 * row['valid_acc_1_1']:.2f} % | {row['mae_mm']:.2f} mm |"
        for model, row in overall(summary, "exact").items()
    ]
    return "\n".join(lines)


def _pairs_table(summary: Mapping[str, Any]) -> str:
    frames, tissues = summary["frames"], summary["tissues"]
    lines = [
        f"The held-out tissues of the data set of pairs ({frames} frames of {tissues} tissues), against the reprojected depth",
        "of the reference camera as in the paper, over all pixels of its validity mask, with 95 % intervals over tissues; last",
        "against exact depth at the same pixels. On the paper's bench, which is real and harder, its network has a mean",
        "absolute error of 3.70 mm.",
        "",
        "| model | MAE | AbsRel | Acc(1.1) | Acc(1.1²) | MAE against exact depth |",
        "|---|---|---|---|---|---|",
    ]
    exact = overall(summary, "exact-at-zivid")
    lines += [
        f"| {shown(model)} | {row['mae_mm']:.2f} mm ({row['mae_mm_low']:.2f} to {row['mae_mm_high']:.2f}) | "
        f"{row['abs_rel']:.4f} | {row['acc_1_1']:.4f} | {row['acc_1_21']:.4f} | {exact[model]['mae_mm']:.2f} mm |"
        for model, row in overall(summary, "zivid").items()
    ]
    reference = exact["reference"]
    lines.append(f"| the reference camera itself | | | | | {reference['mae_mm']:.2f} mm |")
    return "\n".join(lines)


def _sensor_paragraph(
    characterization: Mapping[str, Any], calibration: Mapping[str, Any], collection: Mapping[str, Any]
) -> str:
    contrast, error = characterization["contrast"], calibration["reprojection_error_px"]
    true, statistics = calibration["true_residual"], collection["statistics"]
    pairs, tissues = (sum(statistics[name].values()) for name in ("pairs", "tissues"))
    lines = [
        f"Michelson contrast of the stripes on an inclined target: {contrast['70']:.2f} at 70 mm and {contrast['100']:.2f} at",
        "100 mm (0.58 and 0.44 on the laparoscope that the simulator follows).",
        "",
        (
            f"Calibration from {calibration['config']['views']} views a step: reprojection error "
            f"{error['scope']:.3f} px (scope) and {error['reference']:.3f} px (reference camera); against"
        ),
        (
            "the truth, which only a simulator knows, the transform between the two cameras is off by "
            f"{true['stereo']['rotation_deg']:.3f} degrees and"
        ),
        (
            f"{true['stereo']['translation_mm']:.2f} mm, hand-eye by {true['hand_eye']['rotation_deg']:.3f} degrees and "
            f"{true['hand_eye']['translation_mm']:.2f} mm, depth through the calibrated projector"
        ),
        f"by {true['projector']['depth_rms_mm']:.3f} mm at 100 mm.",
        "",
        (
            f"Data set of {pairs} pairs of {tissues} tissues: {collection['wall_s'] / 60:.0f} minutes on two cores with the "
            f"calibration, {collection['megabytes_per_pair']:.1f} MB a pair;"
        ),
        (
            f"reference depth on {100 * statistics['valid_share']['mean']:.0f} % of the pixels, within "
            f"{statistics['difference_p95_mm']['median']:.2f} mm of exact depth on 95 % of them (median over the pairs)."
        ),
    ]
    return "\n".join(lines)


def _bench_table(summary: Mapping[str, Any]) -> str:
    machine, factor, in_loop = summary["machine"], summary["loop"]["real_time_factor"], summary["loop"]["stage_ms"]
    lines = [
        f"Time of each stage on {machine['usable_cores']} cores ({machine['cpu']}): median, 5th to 95th percentile.",
        f"The whole loop runs at {factor['median']:.2f} of real time without recording. Physics takes a median of",
        f"{in_loop['physics']:.2f} ms for each step of 2 ms, a control tick {in_loop['control']:.2f} ms. Beside them an image",
        f"takes {in_loop['render']:.0f} ms and then `compact` {in_loop['perception']:.0f} ms, which the loop waits for.",
        *_tick_lines({stage["name"]: stage for stage in summary["stages"]}),
        "",
        "| stage | median | target | 5-95 % | 99 % | target |",
        "|---|---|---|---|---|---|",
    ]
    for stage in summary["stages"]:
        median, most = ("" if stage[name] is None else f"{stage[name]:g} ms" for name in ("limit_ms", "limit_p99_ms"))
        spread = f"{stage['p5_ms']:.2f}-{stage['p95_ms']:.2f} ms"
        lines.append(
            f"| {stage['name']} | {stage['p50_ms']:.2f} ms | {median} | {spread} | {stage['p99_ms']:.2f} ms | {most} |"
        )
    return "\n".join(lines)


def _tick_lines(stages: Mapping[str, Mapping[str, Any]]) -> list[str]:
    part, whole = "kinematics, QP, prediction", "prediction"
    names = [f"{place}: {what}" for place in ("control tick", "control tick alone") for what in (part, whole)]
    most = [f"{stages[name]['p99_ms']:.2f} ms" for name in names]
    asked = f"{stages[names[2]]['limit_p99_ms']:g} ms"
    return [
        f"Alone on a core, as on a computer of their own, 99 of 100 control ticks take at most {most[2]} for kinematics,",
        f"quadratic program and prediction, and {most[3]} with the measurement of the depth frame (target: {asked}). In the",
        f"loop, where physics leaves nothing of them in the caches, the same ticks take {most[0]} and {most[1]}.",
    ]


if __name__ == "__main__":
    main(sys.argv[1:])
