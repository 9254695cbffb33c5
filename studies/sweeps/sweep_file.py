"""Sweeps as TOML files: what may stand in one, and how its conditions come from it.

Paths name fields of the episode's configuration as on the command line: `loop.camera_hz` is that of the task's loop,
`perception.name` another part's. A single word is an option of `laploop run`, such as `prediction`, or a field of the task.
"""

import dataclasses
import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from pydantic import JsonValue

from laploop.configuration import Field, configuration, from_plain, to_plain
from laploop.errors import InvalidValueError, LaploopError, UnknownNameError, check_file
from laploop.studies.sweeps.analyses.findings import analysis_named
from laploop.studies.sweeps.conditions import Axis, Settings, check_buildable, episode_of
from laploop.studies.sweeps.sweep import Condition, Label, Pairing, Sweep
from laploop.studies.sweeps.tick_metrics import METRICS

SHIPPED = files("laploop.studies.sweeps") / "shipped"

_LARGEST_FILE = 2**20
_MOST_EPISODES = 100_000

Table = dict[str, JsonValue]
Seeds = Annotated[int, Field(ge=1, le=100_000)]
Metrics = Annotated[tuple[str, ...], Field(min_length=1, max_length=len(METRICS))]


def _check_metrics(names: Sequence[str]) -> None:
    for name in names:
        if name not in METRICS:
            raise UnknownNameError("metric", name, METRICS)


@configuration
class ConditionFile:
    """A named part of a sweep."""

    name: str
    """What tables and figures call it."""
    set: Table = Field(default_factory=dict)
    """Paths and values beside, or in place of, the base's."""
    vary: Table | None = None
    """Lists of values, crossed; by default those of the file's top."""
    metrics: Metrics | None = None
    """What its figures show, in place of the file's metrics."""

    def __post_init__(self) -> None:
        _check_metrics(self.metrics or ())


@configuration
class SwitchFile:
    """Something that is left as it is in half of the conditions, and set in the other half."""

    name: str
    """What tables and figures call it."""
    set: Table
    """Paths and values where it is `ideal`; left out where it is `real`."""


@configuration
class QuickFile:
    """What `--quick` runs in place of the whole."""

    seeds: Seeds | None = None
    base: Table = Field(default_factory=dict)
    """Further paths and values of the base."""
    vary: Table = Field(default_factory=dict)
    """Lists in place of those of the same axes, wherever they stand."""
    conditions: tuple[str, ...] | None = None
    """Names of those to keep."""
    switches: tuple[str, ...] | None = None
    """Names of those to keep; the others stay real."""


@configuration
class SweepFile:
    """Everything that a sweep's file may say."""

    title: str
    about: str = ""
    """In words, what the title does not say."""
    analysis: str = "generic"
    """Which analysis tells the results."""
    seeds: Seeds = 8
    """Episodes a condition."""
    first_seed: Annotated[int, Field(ge=0, lt=2**30)] = 0
    metrics: Metrics = ("total_rms_mm", "normal_rms_mm", "lateral_rms_mm", "force_max_n", "depth_age_mean_ms")
    """What tables and figures show; the first is the most important."""
    pairing: Pairing = "same-seeds"
    base: Table = Field(default_factory=dict)
    """Paths and values that all conditions share."""
    vary: Table = Field(default_factory=dict)
    """Lists of values by path, crossed. An item `{label = ..., set = {...}}` sets several paths at once; its axis may then have
    any name."""
    conditions: Annotated[tuple[ConditionFile, ...], Field(min_length=0, max_length=1000)] = ()
    switches: Annotated[tuple[SwitchFile, ...], Field(min_length=0, max_length=10)] = ()
    """Crossed with everything: 2^n."""
    labels: dict[str, str] = Field(default_factory=dict)
    """What figures call an axis, with its unit in brackets, by axis."""
    quick: QuickFile = Field(default_factory=QuickFile)

    def __post_init__(self) -> None:
        _check_metrics(self.metrics)
        analysis_named(self.analysis)
        for kind, group in (("conditions", self.conditions), ("switches", self.switches)):
            names = [one.name for one in group]
            if doubled := {name for name in names if names.count(name) > 1}:
                raise InvalidValueError(kind, min(doubled), "names that differ")


def shipped_names() -> list[str]:
    """Return the names of the sweeps that come with laploop."""
    return sorted(entry.name.removesuffix(".toml") for entry in SHIPPED.iterdir() if entry.name.endswith(".toml"))


def read_sweep(name_or_file: str, *, quick: bool = False, seeds: int | None = None, trust: bool = False) -> Sweep:
    """Read a sweep, and refuse it if an episode of it could not begin.

    Args:
        name_or_file: A shipped sweep's name, or the path of a TOML file.
        quick: Whether to run the short form.
        seeds: Episodes a condition, in place of the file's number.
        trust: Whether the file may name code, as module:Class, which is then run.

    Raises:
        LaploopError: If there is no such sweep, or something in it is not allowed; the message names file, line and reason.
    """
    text, place, folder = _text(name_or_file)
    try:
        plain = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(place, " ".join(str(error).split())[:200], "a sweep as TOML") from error
    try:
        described = from_plain(SweepFile, plain)
    except LaploopError as error:
        raise error.at(_placed(place, text, re.findall(r"[\w.]+", str(error))[:6]), ": ") from None
    if not trust and (named := next(_named_code(plain), None)) is not None:
        where = _placed(place, text, [named[0]])
        raise InvalidValueError(f"{where}: {named[0]}", named[1], "no module:Class from a file without --trust")
    axes = {axis for table in (described.vary, *(one.vary or {} for one in described.conditions)) for axis in table}
    if (astray := next((axis for axis in described.labels if axis not in axes), None)) is not None:
        raise UnknownNameError("axis in labels", astray, axes).at(_placed(place, text, [astray]), ": ")
    if quick:
        described = _quick(described, place, text)
    if seeds is not None:
        described = dataclasses.replace(described, seeds=seeds)
    conditions = tuple(_conditions(described, place, text, folder))
    sweep = Sweep(
        name=Path(place).stem,
        title=described.title,
        about=" ".join(described.about.split()),
        conditions=conditions,
        seeds=described.seeds,
        metrics=described.metrics,
        group_metrics={one.name: one.metrics for one in described.conditions if one.metrics is not None},
        pairing=described.pairing,
        analysis=described.analysis,
        labels=described.labels,
        text=text,
        quick=quick,
    )
    if sweep.count > _MOST_EPISODES:
        raise InvalidValueError(place, f"{sweep.count} episodes", f"at most {_MOST_EPISODES}")
    try:
        check_buildable(condition.episode for condition in conditions)
    except LaploopError as error:
        raise error.at(_placed(place, text, re.findall(r"[\w.]+", str(error))), ": ") from None
    return sweep


def _text(name_or_file: str) -> tuple[str, str, Path]:
    """Return a sweep's text, its place for messages, and the folder that its files are relative to."""
    if name_or_file in shipped_names():
        entry = SHIPPED / f"{name_or_file}.toml"
        return entry.read_text(encoding="utf-8"), entry.name, Path()
    if not name_or_file.endswith(".toml"):
        raise UnknownNameError("study (a file's name ends in .toml)", name_or_file, shipped_names())
    path = check_file("sweep", name_or_file, f"give a TOML file or one of {', '.join(shipped_names())}")
    if (size := path.stat().st_size) > _LARGEST_FILE:
        raise InvalidValueError(str(path), f"{size} bytes", f"at most {_LARGEST_FILE}")
    try:
        return path.read_bytes().decode("utf-8-sig"), str(path), path.parent
    except UnicodeDecodeError as error:
        raise InvalidValueError(str(path), str(error), "text in UTF-8") from error


def _quick(described: SweepFile, place: str, text: str) -> SweepFile:
    quick = described.quick
    for kind, kept, there in (
        ("conditions", quick.conditions, described.conditions),
        ("switches", quick.switches, described.switches),
    ):
        for name in kept or ():
            if name not in {one.name for one in there}:
                raise UnknownNameError(kind, name, (one.name for one in there)).at(_placed(place, text, ["quick"]), ": ")

    def shortened(vary: Table) -> Table:
        return {axis: quick.vary.get(axis, values) for axis, values in vary.items()}

    return dataclasses.replace(
        described,
        seeds=quick.seeds or described.seeds,
        base={**described.base, **quick.base},
        vary=shortened(described.vary),
        conditions=tuple(
            dataclasses.replace(one, vary=None if one.vary is None else shortened(one.vary))
            for one in described.conditions
            if quick.conditions is None or one.name in quick.conditions
        ),
        switches=tuple(one for one in described.switches if quick.switches is None or one.name in quick.switches),
    )


def _conditions(described: SweepFile, place: str, text: str, folder: Path) -> Iterator[Condition]:
    switched = [
        Axis(one.name, (("real", Settings({}, folder)), ("ideal", Settings(one.set, folder)))) for one in described.switches
    ]
    base = Settings(described.base, folder)
    groups: Sequence[ConditionFile] = described.conditions or (ConditionFile(name=""),)
    number = 0
    for group in groups:
        vary = described.vary if group.vary is None else group.vary
        axes = [*(_axis(axis, values, place, text, folder) for axis, values in vary.items()), *switched]
        seen: dict[str, str] = {}
        for chosen in itertools.product(*(axis.items for axis in axes)):
            values: dict[str, Label] = {axis.name: label for axis, (label, _) in zip(axes, chosen, strict=True)}
            parts = [base, Settings(group.set, folder), *(settings for _, settings in chosen)]
            paths = [path for part in parts for path in part.values]
            try:
                episode = episode_of(parts)
            except LaploopError as error:
                raise error.at(_placed(place, text, [*_mentioned(paths, str(error)), *reversed(paths)]), ": ") from None
            first = described.first_seed + (number * described.seeds if described.pairing == "own-seeds" else 0)
            condition = Condition(group=group.name, values=values, episode=episode, first_seed=first)
            same = seen.setdefault(json.dumps(to_plain(episode), sort_keys=True), condition.name)
            # A cause that is off already is the same real and ideal, and its part of a budget nothing.
            if same != condition.name and not switched:
                raise InvalidValueError(place, f"{same!r} and {condition.name!r}", "conditions whose episodes differ")
            number += 1
            yield condition


def _axis(name: str, values: JsonValue, place: str, text: str, folder: Path) -> Axis:
    where = _placed(place, text, [name])
    if not isinstance(values, list) or not values:
        raise InvalidValueError(f"{where}: {name}", values, "a list of at least one value")
    items: list[tuple[Label, Settings]] = []
    for value in values:
        if isinstance(value, float) and not math.isfinite(value):
            raise InvalidValueError(f"{where}: {name}", value, "finite numbers")
        if isinstance(value, dict) and value.keys() == {"label", "set"}:
            label, settings = value["label"], value["set"]
            if not isinstance(label, str | int | float | bool) or not isinstance(settings, dict):
                raise InvalidValueError(f"{where}: {name}", value, "a label, text or a number, and a table of paths to set")
        else:
            label = value if isinstance(value, str | int | float | bool) else json.dumps(value, sort_keys=True)
            settings = {name: value}
        if label in [before for before, _ in items]:
            raise InvalidValueError(f"{where}: {name}", values, f"each value once; {label!r} is there twice")
        items.append((label, Settings(settings, folder)))
    return Axis(name, tuple(items))


def _mentioned(paths: Sequence[str], message: str) -> list[str]:
    """Return the paths that a message is about, the likeliest first: before it lists what is allowed, it names their end."""
    subject = message.partition("; ")[0].replace(" ", "_")
    quoted = re.search(r"'([^']+)'", message)
    about = [path for path in paths if path.rpartition(".")[2] in subject or (quoted is not None and quoted[1] in path)]
    return sorted(about, key=lambda path: (quoted is None or quoted[1] not in path, -len(path), path))


def _placed(place: str, text: str, keys: Sequence[str]) -> str:
    """Return the file with the line of the first key that stands in it."""
    lines = text.splitlines()
    for key in keys:
        for name in dict.fromkeys((key, key.rpartition(".")[2])):
            pattern = re.compile(rf"""(^|[\s"'{{,.\[]){re.escape(name)}["']?\s*(=|\]|\.)""")
            for number, line in enumerate(lines, 1):
                if name and not line.lstrip().startswith("#") and pattern.search(line):
                    return f"{place}, line {number}"
    return place


def _named_code(plain: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield where a file names code by `module:Class`, and what it names."""
    if isinstance(plain, Mapping):
        for key, value in plain.items():
            yield from _named_code(value, str(key))
    elif isinstance(plain, list):
        for value in plain:
            yield from _named_code(value, path)
    elif (
        isinstance(plain, str) and re.fullmatch(r"[\w.]+:[\w.]+", plain) and path not in {"title", "about", "label", "address"}
    ):
        yield path, plain
