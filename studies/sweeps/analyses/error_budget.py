"""Tells what each cause of error costs at the tool tip: Shapley values over all combinations of causes, seed by seed."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from laploop.studies.sweeps.analyses import generic
from laploop.studies.sweeps.analyses.findings import Findings
from laploop.studies.sweeps.analyses.shapley import shapley_values
from laploop.studies.sweeps.analyses.wording import listed, quantity, spread
from laploop.studies.sweeps.bootstrap import Estimate, estimate
from laploop.studies.sweeps.chart import Chart, Series
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep
from laploop.studies.sweeps.tick_metrics import METRICS

_STATES = {"real", "ideal"}


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return a budget and its waterfall for each part and metric; the generic charts for a sweep without switches."""
    budgets = [
        budget
        for part in generic.parts_of(sweep, outcomes)
        for metric in sweep.metrics_of(part[0].condition.group)
        if (budget := budget_of(part, metric)) is not None
    ]
    if not budgets:
        return generic.analyse(sweep, outcomes)
    charts = tuple(_waterfall(budget) for budget in budgets)
    sentences = tuple(_sentence(budget) for budget in budgets)
    return Findings(charts=charts, results={"budgets": budgets}, sentences=sentences, markdown=_markdown(budgets))


def budget_of(part: Sequence[Outcome], metric: str) -> dict[str, Any] | None:
    """Return what each cause adds to a metric; None where no seed has it in all combinations.

    Returns:
        `metric`, `part`, `seeds` that count, and estimates: `ideal` with all causes ideal, `real` with none, and `causes`,
        whose means add up to the difference of both.
    """
    causes = [axis for axis in part[0].condition.values if {one.condition.values[axis] for one in part} == _STATES]
    by_real = {frozenset(axis for axis in causes if one.condition.values[axis] == "real"): one for one in part}
    if not causes or len(by_real) != 2 ** len(causes) or len(by_real) != len(part):
        return None
    costs = {real: one.values(metric) for real, one in by_real.items()}
    known = [seed for seed in range(len(part[0].rows)) if all(values[seed] is not None for values in costs.values())]
    tables = [{real: float(values[seed] or 0.0) for real, values in costs.items()} for seed in known]
    parts = [shapley_values(causes, table.__getitem__) for table in tables]
    ideal = estimate([costs[frozenset()][seed] for seed in known])
    real = estimate([costs[frozenset(causes)][seed] for seed in known])
    if ideal is None or real is None:
        return None
    return {
        "part": part[0].condition.group,
        "metric": metric,
        "seeds": len(known),
        "ideal": asdict(ideal),
        "real": asdict(real),
        "causes": {cause: _as_dict(estimate([one[cause] for one in parts])) for cause in causes},
    }


def _as_dict(found: Estimate | None) -> dict[str, Any]:
    return {} if found is None else asdict(found)


def _sentence(budget: Mapping[str, Any]) -> str:
    """Say where the budget goes: to causes whose interval leaves out 0, the largest first."""
    what, unit = quantity(METRICS[budget["metric"]])
    causes = sorted(budget["causes"].items(), key=lambda item: -item[1]["mean"])
    sure = [(cause, found) for cause, found in causes if found["low"] > 0.0 or found["high"] < 0.0]
    others = [cause for cause, _ in causes if cause not in dict(sure)]
    ends = f"{budget['ideal']['mean']:.3g}{unit} with all causes ideal, {budget['real']['mean']:.3g}{unit} with all real"
    parts = [f"{found['mean']:+.3g}{unit} by {cause}" for cause, found in sure]
    unsure = f" The interval of {listed(others)} holds 0." if others else ""
    subject = ": ".join(filter(None, (budget["part"], what)))
    return f"{subject[0].upper()}{subject[1:]} is {ends}; {listed(parts) or 'no cause surely has a part'}.{unsure}"


def _waterfall(budget: Mapping[str, Any]) -> Chart:
    """Return bars that lead from all ideal to all real, the largest cause first."""
    causes = sorted(budget["causes"].items(), key=lambda item: -item[1]["mean"])
    steps = [("all ideal", budget["ideal"], 0.0)]
    level = budget["ideal"]["mean"]
    for cause, found in causes:
        steps.append((cause, found, level))
        level += found["mean"]
    steps.append(("all real", budget["real"], 0.0))
    label = METRICS[budget["metric"]]
    return Chart(
        name="-".join(filter(None, ("budget", budget["part"].replace(" ", "-"), budget["metric"]))),
        title=": ".join(filter(None, (budget["part"], label))),
        x_label="cause",
        y_label=label,
        kind="bars",
        series=(
            Series(
                name=label,
                x=[name for name, _, _ in steps],
                y=[found["mean"] for _, found, _ in steps],
                low=[found["low"] for _, found, _ in steps],
                high=[found["high"] for _, found, _ in steps],
                base=[base for _, _, base in steps],
            ),
        ),
        note="Each bar begins where the one before ends. A cause's part is averaged over all orders in which the causes could "
        "be added (Shapley); it may be negative. Whiskers are 95 % intervals of the part over seeds.",
    )


def _markdown(budgets: Sequence[Mapping[str, Any]]) -> str:
    causes = list(dict.fromkeys(cause for one in budgets for cause in one["causes"]))
    lines = [
        "## Budget",
        "",
        f"| part | metric | all ideal | {' | '.join(causes)} | all real | seeds |",
        "|---" * (len(causes) + 5) + "|",
    ]
    for one in budgets:
        cells = [one["ideal"], *(one["causes"].get(cause) for cause in causes), one["real"]]
        shown = ["" if not cell else spread(Estimate(**cell)) for cell in cells]
        lines.append(f"| {one['part']} | {one['metric']} | {' | '.join(shown)} | {one['seeds']} |")
    return "\n".join(lines)
