"""The campaigns of the table of tasks: which episodes, what is measured, and the targets."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from laploop.envs.episode_config import OWN, EpisodeConfig
from laploop.envs.tasks.registry import TASKS, Criterion, Statistic, task_spec
from laploop.studies.episodes.trials import Row, wilson_interval

TROCAR = "trocar error, worst of both arms"
FORCE = "contact force"
COLLISIONS = "physics steps with a collision"
LIMITS = "greatest share of a joint's limits"
"""Names of numbers that every campaign has."""

_SHARES = ("joint_position_share", "joint_speed_share", "command_speed_share", "command_acceleration_share")
_SOLVER_TOLERANCE = 1e-5
"""Share of a limit that the controllers' solver leaves open."""


@dataclass(frozen=True, kw_only=True)
class Check(Criterion):
    """One number of a campaign, and its bound, if it has one.

    Its column is a row's own, one in its `metrics` or `limits`, or `rcm_mm` or `limit_share`, the worst of several.
    """

    relative_to: str | None = None
    """Another campaign: the number is then how many times as large the statistic is there as here."""

    def result(self, rows: Sequence[Row], others: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
        """Return the number, whether it meets its bound, and its spread over the episodes.

        An episode without a value, because it ended before there was anything to measure, does not meet a bound. `others` has
        the rows of all campaigns.
        """
        values = [value for row in rows if (value := column_value(row, self.column)) is not None]
        value = _statistic(values, self.statistic)
        if self.relative_to is not None:
            there = [one for row in others.get(self.relative_to, ()) if (one := column_value(row, self.column)) is not None]
            other = _statistic(there, self.statistic)
            value = None if value is None or other is None or value <= 0.0 else other / value
        return {
            "name": self.name,
            "unit": self.unit,
            "statistic": self.statistic,
            "value": value,
            "at_most": self.at_most,
            "at_least": self.at_least,
            "bar": self.bar(),
            "met": self._met(value, missing=len(rows) - len(values)),
            "missing": len(rows) - len(values),
            "spread": None if not values or self.relative_to else {"min": min(values), "max": max(values)},
        }

    def _met(self, value: float | None, *, missing: int) -> bool | None:
        if self.at_most is None and self.at_least is None:
            return None
        if value is None or missing:
            # A comparison with a campaign that was not run says nothing.
            return None if self.relative_to is not None and value is None and not missing else False
        return (self.at_most is None or value <= self.at_most) and (self.at_least is None or value >= self.at_least)


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Episodes that differ in their seed alone, and what is measured of them."""

    name: str
    episode: EpisodeConfig
    checks: tuple[Check, ...]
    """The task's own."""
    about: str = ""
    """In words, what the name does not say."""
    max_force_n: float | None = None
    """Bound of the force on the tip; None only measures it."""

    def common_checks(self) -> tuple[Check, ...]:
        """Return what is measured in every campaign."""
        ideal = self.episode.actuation_name() == "ideal"
        return (
            Check(name=TROCAR, column="rcm_mm", unit="mm", at_most=0.2 if ideal else 0.5),
            Check(name="force at a trocar, sideways", column="port_force_n", unit="N"),
            Check(name=FORCE, column="contact_force_n", unit="N", at_most=self.max_force_n),
            Check(name="room between the shafts", column="shaft_room_mm", unit="mm", statistic="min", at_least=0.0),
            Check(name="room at the wall", column="wall_room_mm", unit="mm", statistic="min", at_least=0.0),
            Check(name=COLLISIONS, column="collision_steps", at_most=0.0),
            Check(name=LIMITS, column="limit_share", at_most=1.0 + _SOLVER_TOLERANCE),
        )

    def result(self, rows: Sequence[Row], others: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
        """Return the campaign's line of the table."""
        successes = sum(bool(row["success"]) for row in rows)
        checks = [check.result(rows, others) for check in (*self.checks, *self.common_checks())]
        errors = sum(row["error"] is not None for row in rows)
        return {
            "campaign": self.name,
            "about": self.about,
            "task": self.episode.task.kind,
            "perception": self.episode.perception.name,
            "motion": self.episode.motion_name(),
            "actuation": self.episode.actuation_name(),
            "prediction": None if self.episode.predictor.name == OWN else self.episode.predictor.name,
            "episodes": len(rows),
            "errors": errors,
            "successes": successes,
            "success_rate": successes / len(rows),
            "success_interval_95": wilson_interval(successes, len(rows)),
            "own_checks": len(self.checks),
            "checks": checks,
            "met": not errors and all(check["met"] is not False for check in checks),
        }


def column_value(row: Row, column: str) -> float | None:
    """Return a number of a row, None if it was not measured."""
    if column == "rcm_mm":
        return _greatest([row["rcm_camera_mm"], row["rcm_tool_mm"]])
    limits = row.get("limits", {})
    if column == "limit_share":
        return _greatest([limits.get(name) for name in _SHARES])
    value = {**row, **row.get("metrics", {}), **limits}.get(column)
    return None if value is None else float(value)


def _greatest(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return max(known) if known else None


def _statistic(values: Sequence[float], name: Statistic) -> float | None:
    if not values:
        return None
    match name:
        case "mean":
            return float(np.mean(values))
        case "rms":
            return math.sqrt(float(np.mean(np.square(values))))
        case "max":
            return max(values)
        case _:
            return min(values)


def own_checks(task: str, **bounds: float) -> tuple[Check, ...]:
    """Return the criteria of a task, with other bounds for those columns that are named."""
    return tuple(
        Check(**asdict(one) | _bound(one, bounds[one.column]) if one.column in bounds else asdict(one))
        for one in task_spec(task).criteria
    )


def _bound(criterion: Criterion, value: float) -> dict[str, Any]:
    return {"at_most": value} if criterion.at_least is None else {"at_least": value}


def _unbounded(checks: Sequence[Check]) -> tuple[Check, ...]:
    return tuple(replace(check, at_most=None, at_least=None) for check in checks)


_UNPREDICTED = "track-oracle-unpredicted"
_GAIN = Check(name=f"gain over {_UNPREDICTED}", column="normal_rms_mm", statistic="rms", at_least=3.0, relative_to=_UNPREDICTED)
_REACH, _TRACK, _PALPATE, _SCAN, _LOOK = (own_checks(task) for task in ("reach", "track", "palpate", "scan", "look"))

_TRACKING = EpisodeConfig.of(task="track", motion="both", seconds=14.0, perception_latency_ms=40.0, transfer_latency_ms=60.0)
"""100 ms of latency in all, at the camera's full rate; after the 10 s in which prediction has to converge, one breath."""
_PALPATING = EpisodeConfig.of(task="palpate", motion="still", seconds=14.0)
_SCANNING = EpisodeConfig.of(task="scan")
_LOOKING = EpisodeConfig.of(task="look", motion="breathing", seconds=8.0)
_TRACK_ABOUT = "10 mm at 0.25 Hz and 1 mm at 1.2 Hz, 100 ms of latency; measured from 10 to 14 s"
_PALPATE_ABOUT = "0.5 N within 0.1 N for 95 % of 3 s; from the first tick in the band to the end"
_LOOK_ABOUT = "breathing while the stage travels 20 mm to both sides; measured from 2 to 8 s"

CAMPAIGNS: tuple[Campaign, ...] = (
    Campaign(
        name="reach-still",
        episode=EpisodeConfig.of(motion="still"),
        checks=own_checks("reach", success=0.98, final_error_mm=0.8),
    ),
    Campaign(name="reach-moving", about="breathing and beating", episode=EpisodeConfig.of(motion="both"), checks=_REACH),
    Campaign(
        name="track-oracle",
        about=_TRACK_ABOUT,
        episode=_TRACKING.changed(perception="oracle"),
        checks=(*own_checks("track", normal_rms_mm=0.5), _GAIN),
    ),
    Campaign(
        name=_UNPREDICTED,
        about=f"{_TRACK_ABOUT}; the newest measurement is held",
        episode=_TRACKING.changed(perception="oracle", prediction="none"),
        checks=_unbounded(_TRACK),
    ),
    Campaign(name="track-compact", about=_TRACK_ABOUT, episode=_TRACKING, checks=(*_TRACK, _GAIN)),
    Campaign(name="palpate-still", about=_PALPATE_ABOUT, episode=_PALPATING, checks=_PALPATE, max_force_n=2.0),
    Campaign(
        name="palpate-breathing",
        about=_PALPATE_ABOUT,
        episode=_PALPATING.changed(motion="breathing"),
        checks=_unbounded(_PALPATE),
        max_force_n=2.0,
    ),
    Campaign(name="scan-oracle", episode=_SCANNING.changed(perception="oracle"), checks=_SCAN),
    Campaign(name="scan-compact", episode=_SCANNING, checks=_SCAN),
    Campaign(name="look", about=_LOOK_ABOUT, episode=_LOOKING, checks=_LOOK),
    Campaign(
        name="reach-ur5-cb",
        about="breathing and beating",
        episode=EpisodeConfig.of(motion="both", actuation="ur5-cb"),
        checks=_unbounded(_REACH),
    ),
    Campaign(name="track-ur5-cb", about=_TRACK_ABOUT, episode=_TRACKING.changed(actuation="ur5-cb"), checks=_unbounded(_TRACK)),
    Campaign(
        name="palpate-ur5-cb",
        about=_PALPATE_ABOUT,
        episode=_PALPATING.changed(motion="breathing", actuation="ur5-cb"),
        checks=_unbounded(_PALPATE),
        max_force_n=2.0,
    ),
    Campaign(name="scan-ur5-cb", episode=_SCANNING.changed(actuation="ur5-cb"), checks=_unbounded(_SCAN)),
    Campaign(name="look-ur5-cb", about=_LOOK_ABOUT, episode=_LOOKING.changed(actuation="ur5-cb"), checks=_unbounded(_LOOK)),
)
"""Those of the built-in tasks, in the order of the table."""


def campaigns() -> tuple[Campaign, ...]:
    """Return all campaigns: the built-in ones, and one for every task of another package."""
    built_in = {campaign.episode.task.kind for campaign in CAMPAIGNS}
    others = [task for task in TASKS.names() if task not in built_in]
    return CAMPAIGNS + tuple(
        Campaign(name=task, episode=EpisodeConfig.of(task=task), checks=own_checks(task)) for task in others
    )
