"""The findings on a machine with a short run of the loop."""

from collections.abc import Callable, Sequence
from typing import Any

from laploop.envs.episode_config import EpisodeConfig
from laploop.studies.doctor.checks import Check, checks

LOOP_S = 3.0
"""Simulated seconds of the loop."""


def examine(progress: Callable[[float], None] | None = None) -> list[Check]:
    """Return all findings; `progress` is called with the simulated seconds of the loop so far.

    Returns:
        The checks; the last is the loop's, whose speed is a second's worth of simulation over the time that it took.
    """
    found = list(checks())
    # Without its packages the loop would only fail once more.
    return found if any(check.verdict == "bad" for check in found) else [*found, _loop(progress)]


def as_report(found: Sequence[Check]) -> dict[str, Any]:
    """Return the findings as plain values, for a bug report."""
    return {check.name: {"found": check.found, "verdict": check.verdict, "remedy": check.remedy} for check in found}


def _loop(progress: Callable[[float], None] | None) -> Check:
    from laploop.envs.episode import run_episode  # slow to import

    try:
        summary = run_episode(EpisodeConfig.of(task="track", seconds=LOOP_S), progress=progress)
    except Exception as error:  # noqa: BLE001 - whatever is wrong with a machine is a finding
        text = f"{type(error).__name__}: {error}"
        return Check(name="loop", found=text, verdict="bad", remedy="report it, with the output of laploop doctor --json")
    return Check(name="loop", found=f"{summary['real_time_factor']:.2f} of real time over {LOOP_S:.0f} s")
