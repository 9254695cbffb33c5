"""Tells at which gain a loop that is closed through the camera becomes unstable, and how far it overshoots, beside theory."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

from laploop.envs.episode_config import EpisodeConfig
from laploop.studies.sweeps.analyses import generic
from laploop.studies.sweeps.analyses.delay_theory import border_gain_per_s, overshoot_percent
from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.analyses.wording import listed
from laploop.studies.sweeps.bootstrap import estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep

GAIN = "controller.arguments.gain_per_s"

_LARGEST_SMOOTH = 1.2
"""Largest product of gain and delay of a part that is about overshoot; pi / 2 is the border."""


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return growth and border, or overshoot, of the parts that vary the gain, and the sweep's first metrics of the others."""
    charts: list[Chart | None] = []
    borders: list[dict[str, Any]] = []
    overshoots: list[dict[str, Any]] = []
    sentences: list[str] = []
    for part in generic.parts_of(sweep, outcomes):
        if generic.numeric_axis(part) != GAIN:
            charts.append(generic.metric_chart(sweep, part, "total_rms_mm"))
            sentences += generic.changes(sweep, part, "total_rms_mm")
        elif max(gain_delay(one.condition.episode) for one in part) <= _LARGEST_SMOOTH:
            found = [_overshoot(one) for one in part]
            overshoots += found
            charts.append(_overshoot_chart(part, found))
        else:
            borders.append(border := _border(part))
            charts.append(_growth_chart(part, border))
    kept = tuple(chart for chart in charts if chart is not None)
    results = {"borders": borders, "overshoots": overshoots}
    said = (*_border_sentences(borders), *_overshoot_sentences(overshoots), *sentences)
    return Findings(charts=kept, results=results, sentences=said, markdown=_markdown(borders, overshoots))


def frame_delay(episode: EpisodeConfig) -> tuple[float, float]:
    """Return how late frames are typically, and their period, in seconds."""
    loop = episode.task.loop
    stages = (loop.timing.transfer, loop.timing.service, loop.timing.pipeline)
    return 1e-9 * (loop.timing.departure_ns + sum(stage.typical_ns for stage in stages)), 1e-9 * loop.camera_ns


def gain_delay(episode: EpisodeConfig) -> float:
    """Return the product of gain and delay, half a frame period of hold included."""
    delay_s, period_s = frame_delay(episode)
    return float(episode.controller.arguments["gain_per_s"]) * (delay_s + 0.5 * period_s)  # type: ignore[arg-type]


def crossing(gains: Sequence[float], growths: Sequence[float | None]) -> float | None:
    """Return the gain at which growth first passes from negative to positive, in proportion between neighbours."""
    known = [(gain, growth) for gain, growth in zip(gains, growths, strict=True) if growth is not None]
    for (low, below), (high, above) in pairwise(sorted(known)):
        if below < 0.0 <= above:
            return low - below * (high - low) / (above - below)
    return None


def _border(part: Sequence[Outcome]) -> dict[str, Any]:
    """Return the border of stability, seed by seed, and theory's where frames are a whole number of periods late."""
    gains = [float(one.condition.values[GAIN]) for one in part]
    seeds = zip(*(one.values("growth_per_s") for one in part), strict=True)
    found = estimate([crossing(gains, growths) for growths in seeds])
    delay_s, period_s = frame_delay(part[0].condition.episode)
    frames = round(delay_s / period_s)
    whole = abs(delay_s - frames * period_s) < 1e-9
    theory = border_gain_per_s(frames, period_s) if whole else None
    return {
        "part": part[0].condition.group,
        "delay_frames": delay_s / period_s,
        "measured_per_s": None if found is None else asdict(found),
        "theory_per_s": theory,
        "ratio": None if found is None or theory is None else found.mean / theory,
    }


def _overshoot(one: Outcome) -> dict[str, Any]:
    product = gain_delay(one.condition.episode)
    found = estimate(one.values("overshoot_percent"))
    return {
        "gain_delay": product,
        "measured_percent": None if found is None else asdict(found),
        "theory_percent": overshoot_percent(product),
    }


def _border_sentences(borders: Sequence[Mapping[str, Any]]) -> list[str]:
    known = [one for one in borders if one["ratio"] is not None]
    if not known:
        return []
    frames = listed([f"{one['delay_frames']:.0f}" for one in known])
    gains = listed([f"{one['measured_per_s']['mean']:.1f}" for one in known])
    apart = max(abs(one["ratio"] - 1.0) for one in known)
    border = f"Frames {frames} periods late, the servo becomes unstable at a gain of {gains} per second"
    return [f"{border}, within {100 * apart:.1f} % of theory."]


def _overshoot_sentences(overshoots: Sequence[Mapping[str, Any]]) -> list[str]:
    known = [one for one in overshoots if one["measured_percent"] is not None]
    if not known:
        return []
    furthest = max(abs(one["measured_percent"]["mean"] - one["theory_percent"]) for one in known)
    return [f"Overshoot is within {furthest:.1f} points of theory at every product of gain and delay."]


def _growth_chart(part: Sequence[Outcome], border: Mapping[str, Any]) -> Chart:
    points = [(float(one.condition.values[GAIN]), estimate(one.values("growth_per_s"))) for one in part]
    measured = Series.of("simulated", points)
    theory = border["theory_per_s"]
    spread = [*measured.y, 0.0]
    edge = (
        ()
        if theory is None
        else (Series(name="border by theory", x=[theory] * 2, y=[min(spread), max(spread)], kind="theory"),)
    )
    return Chart(
        name=border["part"].replace(" ", "-").replace(",", "") or "border",
        title=f"Growth of the swing: {border['part']}",
        x_label="gain [1/s]",
        y_label="growth rate [1/s]",
        series=(measured, *edge),
        note="Above 0 the loop is unstable. The dashed line is K = 2 sin(pi / (4 d + 2)) / T.",
    )


def _overshoot_chart(part: Sequence[Outcome], found: Sequence[Mapping[str, Any]]) -> Chart:
    points = [(line["gain_delay"], estimate(one.values("overshoot_percent"))) for line, one in zip(found, part, strict=True)]
    products = [0.05 * step for step in range(1 + round(20 * max(product for product, _ in points)))]
    theory = Series(name="theory", x=products, y=[overshoot_percent(product) for product in products], kind="theory")
    return Chart(
        name="overshoot",
        title="Overshoot of a step against gain times delay",
        x_label="gain times delay, the frame's hold included",
        y_label="overshoot [%]",
        series=(Series.of("simulated", points), theory),
        note="Dashed: x' = -K x(t - tau), by the method of steps.",
    )


def _markdown(borders: Sequence[Mapping[str, Any]], overshoots: Sequence[Mapping[str, Any]]) -> str:
    lines = ["## Border of stability", "", "| part | simulated [1/s] | theory [1/s] | ratio |", "|---|---|---|---|"]
    for one in borders:
        cells = (one["measured_per_s"] and one["measured_per_s"]["mean"], one["theory_per_s"], one["ratio"])
        lines.append("| " + " | ".join([one["part"], *("" if cell is None else f"{cell:.4g}" for cell in cells)]) + " |")
    lines += ["", "## Overshoot", "", "| gain times delay | simulated [%] | theory [%] |", "|---|---|---|"]
    for one in overshoots:
        measured = "" if one["measured_percent"] is None else f"{one['measured_percent']['mean']:.1f}"
        lines.append(f"| {one['gain_delay']:.3g} | {measured} | {one['theory_percent']:.1f} |")
    return "\n".join(lines)
