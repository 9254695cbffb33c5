"""The campaigns of the table of tasks: which episodes, what is measured of them, and what is asked."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from laploop.envs.episode import EpisodeConfig
from laploop.studies.episodes.trials import Row, wilson_interval

Statistic = Literal["mean", "rms", "max", "min"]
"""How the episodes' values become one."""

TROCAR = "trocar error, worst of both arms"
FORCE = "contact force"
COLLISIONS = "physics steps with a collision"
LIMITS = "greatest share of a joint's limits"
"""Names of numbers that every campaign has."""

_SHARES = ("joint_position_share", "joint_speed_share", "command_speed_share", "command_acceleration_share")
_SOLVER_TOLERANCE = 1e-5
"""Share of a limit that the controllers' solver leaves open."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number of a campaign, and what is asked of it, if anything."""

    name: str
    column: str
    """Of a row: one of its own, one in its `metrics` or `limits`, or `rcm_mm` or `limit_share`, the worst of several."""
    unit: str = ""
    statistic: Statistic = "max"
    at_most: float | None = None
    at_least: float | None = None
    relative_to: str | None = None
    """Another campaign: the number is then how many times as large the statistic is there as here."""

    def bar(self) -> str:
        """Return what is asked in words; empty for nothing."""
        unit = f" {self.unit}" if self.unit else ""
        if self.at_most is not None:
            return f"at most {self.at_most:.3g}{unit}"
        return "" if self.at_least is None else f"at least {self.at_least:.3g}{unit}"

    def result(self, rows: Sequence[Row], others: Mapping[str, Sequence[Row]]) -> dict[str, Any]:
        """Return the number, whether it is as asked, and its spread over the episodes.

        An episode without a value, as one that ended before there was anything to measure, fails what is asked.

        Args:
            rows: Of the campaign.
            others: The rows of all campaigns that were run.
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
    """Episodes that differ in their seed alone, and what is looked at."""

    name: str
    about: str
    """In words, what the name does not say."""
    episode: EpisodeConfig
    checks: tuple[Check, ...]
    """The task's own."""
    max_force_n: float | None = None
    """Asked of the force on the tip; None only measures it."""

    def common_checks(self) -> tuple[Check, ...]:
        """Return what is looked at in every campaign."""
        ideal = self.episode.actuation == "ideal"
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
            "task": self.episode.task,
            "perception": self.episode.perception,
            "motion": self.episode.motion_name(),
            "actuation": self.episode.actuation,
            "prediction": self.episode.prediction,
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


def _unasked(checks: Sequence[Check]) -> tuple[Check, ...]:
    return tuple(replace(check, at_most=None, at_least=None) for check in checks if check.relative_to is None)


def _reach(success: float, error_mm: float | None) -> tuple[Check, ...]:
    return (
        Check(name="success", column="success", statistic="mean", at_least=success),
        Check(name="final error", column="final_error_mm", unit="mm", statistic="mean", at_most=error_mm),
    )


def _track(rms_mm: float, without: str) -> tuple[Check, ...]:
    along, across = "RMS error along the normal", "RMS error across it"
    return (
        Check(name=along, column="normal_rms_mm", unit="mm", statistic="rms", at_most=rms_mm),
        Check(name=across, column="lateral_rms_mm", unit="mm", statistic="rms"),
        Check(name=f"gain over {without}", column="normal_rms_mm", statistic="rms", at_least=3.0, relative_to=without),
    )


_PALPATE = (
    Check(name="success", column="success", statistic="mean"),
    Check(name="share of the hold time in the band", column="in_band_share", statistic="min", at_least=0.95),
    Check(name="force over the last hold time", column="force_mean_n", unit="N", statistic="mean"),
)
_SCAN = (
    Check(name="RMS of the stand-off", column="standoff_rms_mm", unit="mm", statistic="rms", at_most=0.7),
    Check(name="incidence, mean", column="incidence_mean_deg", unit="deg", statistic="mean"),
    Check(name="incidence, 95th percentile of the worst", column="incidence_p95_deg", unit="deg", at_most=10.0),
    Check(name="share of the scan within 10 deg", column="incidence_within_share", statistic="mean"),
    Check(name="length of the path", column="path_length_mm", unit="mm", statistic="min", at_least=59.5),
    Check(name="share of the path scanned", column="path_progress", statistic="min", at_least=1.0),
)
_LOOK = (
    Check(name="offset from the middle, greatest", column="centre_share_max", unit="of the width", at_most=0.05),
    Check(name="the same, mean 95th percentile", column="centre_share_p95", unit="of the width", statistic="mean"),
    Check(name="error of the working distance, greatest", column="distance_error_max_mm", unit="mm", at_most=5.0),
    Check(name="the same, mean 95th percentile", column="distance_error_p95_mm", unit="mm", statistic="mean"),
)

_TRACK_EPISODE = EpisodeConfig(
    task="track",
    motion="both",
    seconds=14.0,
    perception="compact",
    perception_latency_ns=40_000_000,
    transfer_latency_ns=60_000_000,
)
"""100 ms of latency in all, at the camera's full rate; after the 10 s in which prediction has to converge, one breath."""
_PALPATE_EPISODE = EpisodeConfig(task="palpate", motion="still", perception="compact", seconds=14.0)
_TRACK_ABOUT = "10 mm at 0.25 Hz and 1 mm at 1.2 Hz, 100 ms of latency; measured from 10 to 14 s"
_PALPATE_ABOUT = "0.5 N within 0.1 N for 95 % of 3 s; from the first tick in the band to the end"
_LOOK_ABOUT = "breathing while the stage travels 20 mm to both sides; measured from 2 to 8 s"

CAMPAIGNS: tuple[Campaign, ...] = (
    Campaign(name="reach-still", about="", episode=EpisodeConfig(motion="still"), checks=_reach(0.98, 0.8)),
    Campaign(
        name="reach-moving", about="breathing and beating", episode=EpisodeConfig(motion="both"), checks=_reach(0.95, None)
    ),
    Campaign(
        name="track-oracle",
        about=_TRACK_ABOUT,
        episode=replace(_TRACK_EPISODE, perception="oracle"),
        checks=_track(0.5, "track-oracle-unpredicted"),
    ),
    Campaign(
        name="track-oracle-unpredicted",
        about=f"{_TRACK_ABOUT}; the newest measurement is held",
        episode=replace(_TRACK_EPISODE, perception="oracle", prediction="none"),
        checks=_unasked(_track(0.5, "")),
    ),
    Campaign(name="track-compact", about=_TRACK_ABOUT, episode=_TRACK_EPISODE, checks=_track(1.0, "track-oracle-unpredicted")),
    Campaign(name="palpate-still", about=_PALPATE_ABOUT, episode=_PALPATE_EPISODE, checks=_PALPATE, max_force_n=2.0),
    Campaign(
        name="palpate-breathing",
        about=_PALPATE_ABOUT,
        episode=replace(_PALPATE_EPISODE, motion="breathing"),
        checks=_unasked(_PALPATE),
        max_force_n=2.0,
    ),
    Campaign(name="scan-oracle", about="", episode=EpisodeConfig(task="scan", perception="oracle"), checks=_SCAN),
    Campaign(name="scan-compact", about="", episode=EpisodeConfig(task="scan"), checks=_SCAN),
    Campaign(name="look", about=_LOOK_ABOUT, episode=EpisodeConfig(task="look", motion="breathing", seconds=8.0), checks=_LOOK),
    Campaign(
        name="reach-ur5-cb",
        about="breathing and beating",
        episode=EpisodeConfig(motion="both", actuation="ur5-cb"),
        checks=_unasked(_reach(0.95, None)),
    ),
    Campaign(
        name="track-ur5-cb",
        about=_TRACK_ABOUT,
        episode=replace(_TRACK_EPISODE, actuation="ur5-cb"),
        checks=_unasked(_track(1.0, "")),
    ),
    Campaign(
        name="palpate-ur5-cb",
        about=_PALPATE_ABOUT,
        episode=replace(_PALPATE_EPISODE, motion="breathing", actuation="ur5-cb"),
        checks=_unasked(_PALPATE),
        max_force_n=2.0,
    ),
    Campaign(name="scan-ur5-cb", about="", episode=EpisodeConfig(task="scan", actuation="ur5-cb"), checks=_unasked(_SCAN)),
    Campaign(
        name="look-ur5-cb",
        about=_LOOK_ABOUT,
        episode=EpisodeConfig(task="look", motion="breathing", seconds=8.0, actuation="ur5-cb"),
        checks=_unasked(_LOOK),
    ),
)
"""In the order of the table."""
