"""From paths and values to the configuration of an episode."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from laploop.assets.phantom_import.phantom_mesh import load_phantom
from laploop.configuration import at_path, merged
from laploop.control.controllers.registry import make_controller
from laploop.envs.episode_config import OWN, EpisodeConfig, EpisodeOptions
from laploop.envs.tasks.registry import task_spec
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.studies.sweeps.sweep import Label

_OPTIONS = {field.name for field in dataclasses.fields(EpisodeOptions)}
_FILES = ("latency_trace", "compute_trace", "weights", "phantom")
"""Options that name a file."""
_PARTS = {field.name for field in dataclasses.fields(EpisodeConfig)}


@dataclass(frozen=True)
class Settings:
    """Paths of an episode's configuration, or names of its options, and their values."""

    values: Mapping[str, Any]
    folder: Path
    """What files are relative to."""

    def applied_to(self, episode: EpisodeConfig) -> EpisodeConfig:
        """Return an episode with these in place, options first.

        Raises:
            LaploopError: If there is no such path or option, or a value is not allowed.
        """
        if "seed" in self.values:
            raise InvalidValueError("seed", self.values["seed"], "none here: first_seed and seeds decide which seeds there are")
        options = self._options()
        for name in _FILES:
            if isinstance(options.get(name), str):
                options[name] = self.folder / Path(options[name]).expanduser()
        # Not through `from_plain`, for which the prediction `none` is no prediction given.
        episode = EpisodeOptions(**options).applied_to(episode) if options else episode
        plain: dict[str, Any] = {}
        for path, value in self.values.items():
            if path not in options:
                plain = merged(plain, at_path(self._full(path, episode), value))
        return episode.with_plain(plain) if plain else episode

    def _options(self) -> dict[str, Any]:
        return {name: value for name, value in self.values.items() if name in _OPTIONS and not isinstance(value, Mapping)}

    def _full(self, path: str, episode: EpisodeConfig) -> str:
        first = path.partition(".")[0]
        if first in _PARTS:
            return path
        of_task = {field.name for field in dataclasses.fields(episode.task)}
        if first not in of_task:
            raise UnknownNameError("path", path, _OPTIONS | _PARTS | of_task)
        return f"task.{path}"


def episode_of(parts: Sequence[Settings]) -> EpisodeConfig:
    """Return the default episode of the task that the last part with a task names, with all parts in place, in their order.

    Raises:
        LaploopError: If there is no such path or option, or a value is not allowed.
    """
    named = [{"task": part.values["task"]} for part in parts if isinstance(part.values.get("task"), str)]
    episode = EpisodeOptions(**(named[-1] if named else {})).episode()
    for part in parts:
        kept = {name: value for name, value in part.values.items() if name != "task" or isinstance(value, Mapping)}
        episode = Settings(kept, part.folder).applied_to(episode)
    return episode


class Axis(NamedTuple):
    """Something that differs between conditions, and what it takes."""

    name: str
    items: tuple[tuple[Label, Settings], ...]
    """Labels, and what they stand for."""


def check_buildable(episodes: Iterable[EpisodeConfig]) -> None:
    """Make what is otherwise made when an episode begins: controllers, predictors, estimators, phantoms.

    Raises:
        LaploopError: If one of them cannot be made.
    """
    done: list[Any] = []
    for episode in episodes:
        theatre = episode.task.loop.theatre
        perception, scope = episode.perception, theatre.scope
        parts = (episode.task.kind, episode.controller, episode.predictor, perception, scope, theatre.tissue.mesh)
        if parts in done:
            continue
        done.append(parts)
        rig = Rig.from_optics(scope)
        make_controller(
            task_spec(episode.task.kind).controller if episode.controller.name == OWN else episode.controller.name,
            rig,
            prediction=None if episode.predictor.name == OWN else episode.predictor.name,
            prediction_arguments=episode.predictor.arguments,
            arguments=episode.controller.arguments,
        )
        make_estimator(perception.name, rig, perception.weights, perception.arguments)
        if theatre.tissue.mesh is not None:
            load_phantom(theatre.tissue.mesh)
