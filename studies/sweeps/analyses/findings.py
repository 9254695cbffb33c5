"""What an analysis returns, and which analyses there are."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from laploop.errors import UnknownNameError
from laploop.studies.sweeps.chart import Chart
from laploop.studies.sweeps.run import Outcome
from laploop.studies.sweeps.sweep import Sweep


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What an analysis makes of the rows."""

    charts: tuple[Chart, ...]
    results: Mapping[str, Any] = field(default_factory=dict)
    """For `summary.json`."""
    sentences: tuple[str, ...] = ()
    """What the numbers say, in words."""
    markdown: str = ""
    """Tables of its own."""


Analysis = Callable[[Sweep, Sequence[Outcome]], Findings]

ANALYSES = ("generic", "latency", "delay-margin", "error-budget", "pattern")
"""By the name that a sweep's file gives; `generic` alone does for any sweep."""


def analyse(sweep: Sweep, outcomes: Sequence[Outcome]) -> Findings:
    """Return what the sweep's own analysis finds.

    Raises:
        UnknownNameError: If there is no analysis of that name.
    """
    return analysis_named(sweep.analysis)(sweep, outcomes)


def analysis_named(name: str) -> Analysis:
    """Return an analysis.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name not in ANALYSES:
        raise UnknownNameError("analysis", name, ANALYSES)
    found: Analysis = import_module(f"laploop.studies.sweeps.analyses.{name.replace('-', '_')}").analyse
    return found
