"""Tells what latency, jitter, frame rate and lost frames cost, beside what theory says."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from laploop.configuration import from_plain, merged, to_plain
from laploop.control.controllers.track import TrackControllerConfig
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.loop.timing.latency import MeasuredLatency
from laploop.studies.sweeps.analyses import generic
from laploop.studies.sweeps.analyses.delay_theory import Sine, following_rms_m, pure_delay_rms_m
from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.analyses.wording import listed
from laploop.studies.sweeps.bootstrap import estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep

LATENCY = "loop.timing.pipeline.latency_ms"
METRIC = "total_rms_mm"
"""Along the normal and across it together: the tissue moves along the stage's axis, whatever way its surface leans."""

_STILL_GOOD = 1.5
"""A predictor holds as long as the error is at most this many times that without latency."""

_TOLD_MS = (0.0, 100.0, 200.0, 500.0, 1000.0)
"""Latencies whose errors are put in words."""

_RADIXACT_MS, _RADIXACT_MM = 630.0, 0.76
"""Delay of a radiotherapy system that follows breathing, and its RMS error with prediction (PMC12956478)."""

_TISSUE = {"still": "still", "breathing": "breathing", "beating": "beating", "both": "breathing and beating"}


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return the charts of every part; over latency with theory, and its fit by an exponential."""
    charts: list[Chart] = []
    compared: list[dict[str, Any]] = []
    fits: list[dict[str, Any]] = []
    sentences: list[str] = []
    for part in generic.parts_of(sweep, outcomes):
        said = [line for one in part if (line := _compared(one)) is not None]
        compared += said
        if generic.numeric_axis(part) == LATENCY:
            for motion in dict.fromkeys(str(one.condition.episode.motion_name()) for one in part):
                moved = [one for one in part if one.condition.episode.motion_name() == motion]
                lines = _lines(moved)
                charts.append(_with_theory(moved, lines, motion))
                fits += [{"motion": motion, "series": line.name, **fit} for line in lines if (fit := _exponential(line))]
                sentences += [sentence for line in lines for sentence in _cost(line, _TISSUE[motion])]
                sentences += _beside_radixact(lines) if motion == "breathing" else []
            sentences += _agreement(said)
        else:
            if (chart := generic.metric_chart(sweep, part, METRIC)) is not None:
                charts.append(chart)
            sentences += generic.changes(sweep, part, METRIC)
    if not charts:
        return generic.analyse(sweep, outcomes)
    return Findings(
        charts=tuple(charts),
        results={"theory": compared, "exponential_fits": fits},
        sentences=tuple(sentences),
        markdown=_markdown(compared, fits),
    )


def theory(episode: EpisodeConfig) -> dict[str, float] | None:
    """Return what theory says of an episode of `track` that holds the newest measurement; None where it does not apply.

    Returns:
        `delay_s` and `gain_per_s` as configured, and in millimetres the RMS of a perfect follower of what was seen one mean age
        ago, `pure_delay_mm`, and of the proportional one, `following_mm`.
    """
    loop, timing = episode.task.loop, episode.task.loop.timing
    stages = (timing.transfer, timing.service, timing.pipeline)
    random = any(isinstance(stage, MeasuredLatency) or stage.kind != "constant" for stage in stages)
    if episode.predictor.name != "none" or episode.actuation_name() != "ideal" or timing.drop_rate > 0.0 or random:
        return None
    delay_s = 1e-9 * (timing.departure_ns + sum(stage.typical_ns for stage in stages))
    period_s, gain = 1e-9 * loop.camera_ns, follower_gain_per_s(episode)
    sines = motion_sines(episode)
    return {
        "delay_s": delay_s,
        "gain_per_s": gain,
        "pure_delay_mm": 1e3 * pure_delay_rms_m(sines, delay_s + 0.5 * period_s),
        "following_mm": 1e3 * following_rms_m(sines, delay_s, period_s, gain),
    }


def follower_gain_per_s(episode: EpisodeConfig) -> float:
    """Return the position gain with which the scripted controller of `track` follows, as its arguments have it."""
    plain = merged(to_plain(TrackControllerConfig()), episode.controller.arguments)
    loop = episode.task.loop
    lead_ns = loop.theatre.actuation.lead_ns + loop.timing.command_ns
    return from_plain(TrackControllerConfig, plain).approach.motion.gain(lead_ns)


def motion_sines(episode: EpisodeConfig) -> list[Sine]:
    """Return the amplitudes and frequencies of the tissue's motion."""
    motion = episode.task.loop.theatre.motion
    waves = (
        (0.5 * motion.breathing_peak_to_peak_m, motion.breathing_hz),
        (0.5 * motion.beating_peak_to_peak_m, motion.beating_hz),
    )
    return [wave for wave in waves if wave[0] > 0.0]


def _with_theory(part: Sequence[Outcome], lines: Sequence[Series], motion: str) -> Chart:
    points = {float(one.condition.values[LATENCY]): said for one in part if (said := theory(one.condition.episode)) is not None}
    delays = sorted(points)
    theories = tuple(
        Series(name=name, x=delays, y=[points[delay][key] for delay in delays], kind="theory")
        for name, key in (("theory: delay and gain", "following_mm"), ("theory: delay alone", "pure_delay_mm"))
    )
    held = [line for line in lines if line.name == "none"]
    return Chart(
        name=f"latency-{motion}",
        title=f"RMS error against latency, tissue {_TISSUE[motion]}",
        x_label="latency from capture to use [ms]",
        y_label="RMS error at the tool tip [mm]",
        series=(*(line for line in lines if line not in held), *held, *(theories if points else ())),
        note="Dashed: what delay alone costs a perfect follower, and what delay, frame period and gain cost a proportional "
        "one. Nothing in them is fitted. Bands are 95 % intervals over seeds.",
    )


def _lines(part: Sequence[Outcome]) -> list[Series]:
    """Return a series a predictor; the motion is the chart's."""
    motion = part[0].condition.episode.motion_name()
    lines = generic.lines_over(part, LATENCY, METRIC)
    return [replace(line, name=line.name.removesuffix(f", {motion}")) for line in lines if line.y]


def _cost(line: Series, tissue: str) -> list[str]:
    """Say what latency costs with a predictor, and how far the predictor helps."""
    error_mm = dict(zip([float(x) for x in line.x], line.y, strict=True))
    told = [f"{error_mm[latency]:.3g} mm at {latency:g} ms" for latency in _TOLD_MS if latency in error_mm]
    how = "without prediction" if line.name == "none" else f"with `{line.name}`"
    sentences = [f"Tissue {tissue}, {how}: RMS error {listed(told)}."]
    if line.name == "none" or 0.0 not in error_mm:
        return sentences
    held = 0.0
    for latency in sorted(error_mm):
        if error_mm[latency] > _STILL_GOOD * error_mm[0.0]:
            break
        held = latency
    sentences.append(f"Tissue {tissue}: `{line.name}` stays within {_STILL_GOOD:g} times its error at 0 ms up to {held:g} ms.")
    return sentences


def _beside_radixact(lines: Sequence[Series]) -> list[str]:
    """Say what the best predictor leaves at the delay of a radiotherapy system, beside what that states."""
    known = {line.name: dict(zip(line.x, line.y, strict=True)).get(_RADIXACT_MS) for line in lines if line.name != "none"}
    left = {name: float(error_mm) for name, error_mm in known.items() if error_mm is not None}
    if not left:
        return []
    best = min(left, key=left.__getitem__)
    ours = f"At {_RADIXACT_MS:g} ms, the delay of Radixact, `{best}` leaves {left[best]:.3g} mm of a sine's motion."
    theirs = f"Radixact states {_RADIXACT_MM:g} mm with prediction, of patients, whose breathing is no sine."
    return [f"{ours} {theirs}"]


def _agreement(compared: Sequence[Mapping[str, Any]]) -> list[str]:
    if not compared:
        return []
    furthest = max(compared, key=lambda one: abs(one["ratio"] - 1.0))
    apart = f"{100 * abs(furthest['ratio'] - 1.0):.1f} % ({furthest['condition']})"
    return [f"Without prediction, simulation and theory of delay and gain differ by at most {apart}."]


def _compared(one: Outcome) -> dict[str, Any] | None:
    said, found = theory(one.condition.episode), estimate(one.values(METRIC))
    if said is None or found is None:
        return None
    return {"condition": one.condition.name, "measured_mm": found.mean, **said, "ratio": found.mean / said["following_mm"]}


def _exponential(line: Series) -> dict[str, float] | None:
    """Fit y = a exp(b x) to the logarithms; return a in mm, b per second, and R^2 of y itself."""
    x, y = 1e-3 * np.array(line.x, dtype=np.float64), np.array(line.y)
    if x.size < 3 or y.min() <= 0.0:
        return None
    slope, offset = np.polyfit(x, np.log(y), 1)
    left = y - np.exp(offset + slope * x)
    spread = float(((y - y.mean()) ** 2).sum())
    return {"a_mm": math.exp(offset), "b_per_s": float(slope), "r_squared": 1.0 - float((left**2).sum()) / max(spread, 1e-30)}


def _markdown(compared: Sequence[Mapping[str, Any]], fits: Sequence[Mapping[str, Any]]) -> str:
    lines = [
        "## Theory",
        "",
        "| condition | measured [mm] | delay and gain [mm] | ratio | delay alone [mm] |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {one['condition']} | {one['measured_mm']:.3g} | {one['following_mm']:.3g} | {one['ratio']:.3f} "
        f"| {one['pure_delay_mm']:.3g} |"
        for one in compared
    ]
    lines += ["", "## Fits by a exp(b tau)", "", "Surgeons' errors under delay: R² above 0.98 (Xu 2014).", ""]
    lines += ["| motion | series | a [mm] | b [1/s] | R² |", "|---|---|---|---|---|"]
    lines += [
        f"| {one['motion']} | {one['series']} | {one['a_mm']:.3g} | {one['b_per_s']:.3g} | {one['r_squared']:.3f} |"
        for one in fits
    ]
    return "\n".join(lines)
