"""Episodes from the command line: a file, the options people change most, and every field of the tree by its path.

`--loop.camera-hz 50` sets the field `camera_hz` of the loop. Paths begin at the task, whose own fields need no prefix, or at
another part of the episode, as `--perception.name` does; in a file the task's fields stand under `[task]`.
"""

import json
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

from laploop.cli.parsing import Inlined, option_names, parse_known, unknown_option
from laploop.cli.tree import Leaf, kinds_of, leaves, option_name, options_text
from laploop.configuration import merged
from laploop.envs.earlier_names import present_option, with_present_names
from laploop.envs.episode_config import EpisodeConfig, EpisodeOptions
from laploop.envs.loop.config import LoopConfig
from laploop.errors import InvalidValueError, LaploopError, UsageError, check_file

ROOT = "task"
"""Part of an episode whose fields are named without it."""

_LARGEST_FILE = 64 * 2**20
_EVERYTHING = "--help-all"

Arguments = TypeVar("Arguments")
Plain = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class FileOptions:
    """A configuration file, and whether the code it names may be run."""

    config: Path | None = None
    """Configuration to start from: TOML as `laploop config` writes it, whole or in part, or an earlier run's summary.json."""
    trust: bool = False
    """Accept module:Class from that file, which runs the code it names."""

    def read(self) -> Plain:
        """Return what the file holds, in the layout of `EpisodeConfig`; empty without a file."""
        if self.config is None:
            return {}
        plain = _read(self.config)
        if not self.trust and (named := next(_named_code(plain), None)) is not None:
            raise InvalidValueError(f"{self.config}: {named[0]}", named[1], "no module:Class from a file without --trust")
        return plain

    def loop(self) -> LoopConfig | None:
        """Return the loop that the file configures; None without a file."""
        plain = self.read()
        return _episode(plain, None, str(self.config)).task.loop if plain else None


@dataclass(frozen=True, kw_only=True)
class TreeOptions:
    """What makes an episode."""

    episode: Inlined[EpisodeOptions] = field(default_factory=EpisodeOptions)
    file: Inlined[FileOptions] = field(default_factory=FileOptions)

    def tree(self) -> EpisodeConfig:
        """Return the episode of the file with the options in place."""
        plain = self.file.read()
        if not plain:
            return self.episode.episode()
        return self.episode.applied_to(_episode(plain, self.episode.task, str(self.file.config)))


def parse_tree(kind: type[Arguments], arguments: Sequence[str], command: str) -> tuple[Arguments, list[str]]:
    """Read the arguments of a command that takes a tree; return with them those that set fields of it, for `with_options`."""
    if _EVERYTHING in arguments:
        place = arguments.index("--task") + 1 if "--task" in arguments else len(arguments)
        task = arguments[place] if place < len(arguments) else "reach"
        shown = options_text(EpisodeConfig.of(task=task), ROOT)
        sys.stdout.write(f"Fields of the task {task}, as options of `laploop {command}`:\n\n{shown}")
        raise SystemExit(0)
    return parse_known(kind, arguments, command)


def with_options(episode: EpisodeConfig, tokens: Sequence[str], kind: type) -> EpisodeConfig:
    """Return an episode with those fields changed that options name; `kind`'s own options are suggested for a misspelt one."""
    return episode.with_plain(_assigned(tokens, leaves(episode), kind)) if tokens else episode


def _episode(plain: Plain, task: str | None, source: str) -> EpisodeConfig:
    """Return the episode that a file describes, of the given task where the file names none."""
    return EpisodeConfig.of(task=plain.get(ROOT, {}).get("kind", task)).with_plain(plain, source=source)


def _read(path: Path) -> Plain:
    path = check_file("configuration", path, "write one with `laploop config`")
    name = f"configuration {path}"
    if (size := path.stat().st_size) > _LARGEST_FILE:
        raise InvalidValueError(name, f"{size} bytes", f"at most {_LARGEST_FILE}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        plain = json.loads(text) if text.lstrip().startswith("{") else tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InvalidValueError(name, reason, "TOML as `laploop config` writes it, or a summary.json") from error
    if "command" in plain and isinstance(plain.get("config"), dict):
        plain = plain["config"]
        # `trials` keeps the episode beside its own options.
        plain = plain.get("episode", plain)
    return _in_layout(plain, name)


def _in_layout(plain: Plain, name: str) -> Plain:
    """Move fields of the task from the top, where a file may have them as the command line has, to their place."""
    top = {one.name for one in fields(EpisodeConfig)}
    task = plain.get(ROOT, {})
    task = {"kind": task} if isinstance(task, str) else task
    if not isinstance(task, dict):
        raise InvalidValueError(f"{name}: {ROOT}", task, "a table, or the task's name")
    beside = {key: value for key, value in plain.items() if key not in top}
    rest = {key: value for key, value in plain.items() if key in top and key != ROOT}
    task = merged(task, beside)
    if isinstance(task.get("loop"), dict):
        try:
            task["loop"] = with_present_names(task["loop"])
        except LaploopError as error:
            raise error.at(name, ": ") from None
    return {**rest, ROOT: task} if task else rest


def _named_code(plain: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield where a file names code by `module:Class`, and what it names."""
    if isinstance(plain, Mapping):
        for key, value in plain.items():
            place = f"{path}.{key}" if path else str(key)
            if key in {"kind", "name"} and isinstance(value, str) and ":" in value:
                yield place, value
            yield from _named_code(value, place)


def _assigned(tokens: Sequence[str], known: Mapping[tuple[str, ...], Leaf], kind: type) -> Plain:
    names = {option_name(path, ROOT): leaf for path, leaf in known.items() if path != (ROOT, "kind")}
    plain: Plain = {}
    for token, values in _options(tokens):
        name = token.replace("_", "-")
        name = present_option(name if name in names else name.replace(f"--{ROOT}.", "--", 1))
        leaf = names.get(name)
        parent, _, last = name.rpartition(".")
        if leaf is not None:
            path = leaf.path
        elif parent in names and any(get_origin(one) is dict for one in kinds_of(names[parent].annotation)):
            # An argument of a user's own object.
            leaf, path = names[parent], (*names[parent].path, last.replace("-", "_"))
        else:
            raise _unknown(token, names, kind)
        if not values:
            raise UsageError(f"{token} needs a value{f': {leaf.allowed}' if leaf.allowed else ''}")
        place = plain
        for part in path[:-1]:
            place = place.setdefault(part, {})
        place[path[-1]] = _value(leaf, values)
    return plain


def _options(tokens: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Yield each option with the words that follow it."""
    given: list[tuple[str, list[str]]] = []
    for token in tokens:
        if token.startswith("--"):
            name, equals, value = token.partition("=")
            given.append((name, [value] if equals else []))
        elif given:
            given[-1][1].append(token)
        else:
            raise unknown_option(token, [])
    return iter(given)


def _unknown(token: str, names: Mapping[str, Leaf], kind: type) -> LaploopError:
    below = [name for name in names if name.startswith(f"{present_option(token)}.")]
    if below:
        return UsageError(f"{token} is a table; its fields: {', '.join(below)}")
    options = [*names, *option_names(kind)]
    last = token.rpartition(".")[2]
    # Someone who knows a field's name need not know where it is.
    if not get_close_matches(token, options, n=1) and (there := [name for name in names if name.endswith(f".{last}")]):
        return UsageError(f"unknown option {token}; did you mean {there[0]}?")
    return unknown_option(token, options)


def _value(leaf: Leaf, words: Sequence[str]) -> Any:
    """Return what words stand for, as a file would hold it; what is not allowed is left for the tree to refuse."""
    kinds = kinds_of(leaf.annotation)
    texts = [one for one in kinds if one in {str, Path} or (get_origin(one) is Literal and isinstance(get_args(one)[0], str))]
    numbers = [one for one in kinds if one not in texts and one is not type(None)]
    values = [word if texts and not numbers else _number(word) for word in words]
    listed = any(get_origin(one) is tuple for one in kinds)
    if listed and not (len(values) == 1 and (isinstance(values[0], list) or values[0] == "none")):
        return values
    return values[0] if len(values) == 1 else " ".join(words)


def _number(word: str) -> Any:
    """Return the number, the truth value, the list or the table that a word is, or the word."""
    for read in (json.loads, float):
        try:
            return read(word)
        except (ValueError, RecursionError):
            continue
    return word
