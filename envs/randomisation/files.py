"""Randomisations as files: the shipped levels, and one's own.

A file is a table of paths, dotted or nested, each with a distribution:

    "loop.theatre.tissue.material.young_pa" = {loguniform = [3000, 30000]}
    [loop.timing.service]
    latency_ms = {uniform = [10, 60]}
"""

import tomllib
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from laploop.envs.randomisation.distributions import distribution_of
from laploop.envs.randomisation.randomisation import Randomisation
from laploop.errors import InvalidValueError, LaploopError, UnknownNameError, check_file

SHIPPED = files("laploop.envs.randomisation") / "shipped"

LEVELS = ("none", "narrow", "wide")
"""Names of the shipped randomisations, in the order in which they are listed to users."""

_LARGEST_FILE = 2**20

RandomisationLike = str | Path | Mapping[str, Any] | Randomisation
"""A level's name, the path of a TOML file, what such a file holds, or the object."""


def randomisation_of(given: RandomisationLike) -> Randomisation:
    """Return what a level's name, the path of a TOML file, or a mapping stands for.

    Raises:
        UnknownNameError: If there is no such level, or a distribution that does not exist.
        MissingFileError: If there is no such file.
        InvalidValueError: If it holds anything but paths with distributions.
    """
    if isinstance(given, Randomisation):
        return given
    if isinstance(given, Mapping):
        return _randomisation(given)
    if not isinstance(given, str | Path):
        raise InvalidValueError("randomisation", given, "the name of a level, the path of a TOML file, or a mapping")
    if given in LEVELS:
        return _read((SHIPPED / f"{given}.toml").read_text(encoding="utf-8"), f"{given}.toml")
    if not str(given).endswith(".toml"):
        raise UnknownNameError("randomisation (a file's name ends in .toml)", str(given), LEVELS)
    path = check_file("randomisation", given, f"give a TOML file or one of {', '.join(LEVELS)}")
    if (size := path.stat().st_size) > _LARGEST_FILE:
        raise InvalidValueError(str(path), f"{size} bytes", f"at most {_LARGEST_FILE}")
    try:
        return _read(path.read_bytes().decode("utf-8-sig"), str(path))
    except UnicodeDecodeError as error:
        raise InvalidValueError(str(path), str(error), "text in UTF-8") from error


def _read(text: str, place: str) -> Randomisation:
    try:
        plain = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InvalidValueError(place, " ".join(str(error).split())[:200], "paths with distributions, as TOML") from error
    try:
        return _randomisation(plain)
    except LaploopError as error:
        raise error.at(place, ": ") from None


def _randomisation(plain: Mapping[str, Any]) -> Randomisation:
    distributions = {}
    for path, described in _flat(plain):
        try:
            distributions[path] = distribution_of(described)
        except LaploopError as error:
            raise error.at(path, ": ") from None
    return Randomisation(distributions)


def _flat(plain: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield paths and what should be their distributions: what is not a table of tables."""
    for name, value in plain.items():
        path = f"{before}{name}"
        if isinstance(value, Mapping) and value and all(isinstance(one, Mapping) for one in value.values()):
            yield from _flat(value, f"{path}.")
        else:
            yield path, value
