"""What a sweep is: conditions, each with the configuration of its episodes, and the seeds that all of them share."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from laploop.envs.episode_config import EpisodeConfig

Label = str | float | int | bool
"""A value of an axis as tables and figures show it."""

Pairing = Literal["same-seeds", "own-seeds"]


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One set of values, and the episode that they make."""

    group: str
    """Name of the part of the sweep that it belongs to; empty for a sweep of one part."""
    values: Mapping[str, Label]
    """By axis, in the file's order."""
    episode: EpisodeConfig
    first_seed: int

    @property
    def name(self) -> str:
        """What tables call it."""
        values = ", ".join(f"{axis.rpartition('.')[2]}={shown(value)}" for axis, value in self.values.items())
        return ": ".join(filter(None, (self.group, values))) or "base"

    def episodes(self, seeds: int) -> list[EpisodeConfig]:
        """Return an episode a seed."""
        return [replace(self.episode, seed=self.first_seed + number) for number in range(seeds)]


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Conditions to run with the same seeds, and how to tell what comes out."""

    name: str
    title: str
    about: str
    conditions: tuple[Condition, ...]
    seeds: int
    metrics: tuple[str, ...]
    """What tables and figures show; the first is the most important. Rows hold all that is measured."""
    group_metrics: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """In place of `metrics` in figures and analyses, by part."""
    pairing: Pairing = "same-seeds"
    """Whether all conditions have the same seeds, so that differences are between equal tissues, targets and noise."""
    analysis: str = "generic"
    labels: Mapping[str, str] = field(default_factory=dict)
    """What figures call an axis, by axis."""
    text: str = field(default="", repr=False)
    """The file that describes it."""
    quick: bool = False

    @property
    def count(self) -> int:
        """Number of rows: an episode a condition and seed."""
        return len(self.conditions) * self.seeds

    def metrics_of(self, group: str) -> tuple[str, ...]:
        """Return what figures and analyses of a part show."""
        return self.group_metrics.get(group, self.metrics)

    def label(self, axis: str) -> str:
        """Return what figures call an axis."""
        return self.labels.get(axis, axis)

    def groups(self) -> dict[str, list[Condition]]:
        """Return the conditions of each part, in the file's order."""
        found: dict[str, list[Condition]] = {}
        for condition in self.conditions:
            found.setdefault(condition.group, []).append(condition)
        return found


def shown(value: Label) -> str:
    """Return a label as text."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
