"""Demonstrations as a Minari data set: Parquet, images without loss, the card in its metadata."""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from laploop.errors import DatasetError
from laploop.perception.data.integrity import refusing_damage
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.damage import REMEDY, read_table, require
from laploop.studies.demonstrations.demonstration import VECTOR, Demonstration, Observations
from laploop.studies.demonstrations.recorded import RecordedEpisode, checked_episode, checked_index

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector.episode_buffer import EpisodeBuffer

CARD = "laploop"
"""Key of the card in the metadata of the data set, and of the outcome in those of an episode."""

_METADATA = "metadata.json"
_FORMAT = "parquet"
_NEEDED = (
    "dataset_id",
    "minari_version",
    "data_format",
    "total_episodes",
    "total_steps",
    "observation_space",
    "action_space",
)
"""Of the metadata. Minari would do without the spaces, and make the environment that a foreign data set describes."""


def dataset_id(task: str) -> str:
    """Return the id under which `minari.load_dataset` finds a task's demonstrations in the folder `MINARI_DATASETS_PATH`."""
    return f"laploop/{re.sub(r'[^-0-9A-Za-z_]', '-', task)}-v0"


def write_minari(folder: Path, card: Card, env: gym.Env[Any, Any], demonstrations: Iterable[Demonstration]) -> None:
    """Write a data set to an existing, empty folder, to be read by `minari.MinariDataset(folder)`."""
    import minari
    from minari.dataset.minari_storage import MinariStorage

    # The storage that `minari.create_dataset_from_buffers` fills, which holds all episodes in memory at once.
    storage = MinariStorage.new(
        folder.absolute(),  # it joins a relative one with itself
        observation_space=env.observation_space,
        action_space=env.action_space,
        env_spec=env.spec,
        data_format=_FORMAT,
        jpeg_encoding=False,
    )
    storage.update_metadata(
        {
            "dataset_id": dataset_id(card.task),
            "minari_version": minari.__version__,
            "algorithm_name": f"scripted controller {card.expert['controller']}",
            "description": card.instruction,
            "requirements": [f"laploop=={card.laploop}"],
            CARD: card.plain,
        }
    )
    outcomes: list[dict[str, Any]] = []
    storage.update_episodes(_buffers(demonstrations, env.observation_space, outcomes))
    storage.update_episode_metadata([{CARD: outcome} for outcome in outcomes])


def _buffers(
    demonstrations: Iterable[Demonstration], space: spaces.Space[Any], outcomes: list[dict[str, Any]]
) -> Iterator["EpisodeBuffer"]:
    from minari.data_collector.episode_buffer import EpisodeBuffer

    for one in demonstrations:
        outcomes.append(one.outcome)
        yield EpisodeBuffer(
            seed=one.outcome["seed"],
            observations=one.observations if isinstance(space, spaces.Dict) else one.observations[VECTOR],
            actions=one.actions,
            rewards=one.rewards.tolist(),
            terminations=one.terminations.tolist(),
            truncations=one.truncations.tolist(),
            # Minari cannot read an array of one dimension again.
            infos={
                "expert_action": one.expert_actions,
                "privileged": one.privileged,
                "is_success": one.successes.tolist(),
            },
        )


class MinariDemonstrations:
    """A Minari data set that `write_minari` wrote."""

    def __init__(self, folder: Path) -> None:
        """Open it.

        Raises:
            DatasetError: If it is damaged, of another kind, or made by another version of laploop.
        """
        metadata = read_table(folder / _METADATA)
        self.card = Card.read(metadata.get(CARD), folder)
        require(folder / _METADATA, "field", _NEEDED, metadata)
        if (found := metadata["data_format"]) != _FORMAT:
            raise DatasetError(f"{folder / _METADATA} has the data_format {found!r}; allowed: {_FORMAT!r}; {REMEDY}")
        self.dataset = self._opened(folder)
        """Minari's own."""
        self.count = self.dataset.total_episodes
        self._folder = folder

    def episode(self, index: int) -> RecordedEpisode:
        """Return an episode; raises as `RecordedDemonstrations.episode`."""
        checked_index(index, self.count)
        place = f"episode {index} of {self._folder}"
        with refusing_damage(place, REMEDY):
            found = self.dataset[index]
            (metadata,) = self.dataset.storage.get_episode_metadata([index])
            require(place, "infos", ["expert_action"], found.infos)
            episode = RecordedEpisode(
                observations=_by_key(found.observations),
                actions=np.asarray(found.actions),
                expert_actions=np.asarray(found.infos["expert_action"])[: len(found.actions)],
                rewards=np.asarray(found.rewards),
                terminations=np.asarray(found.terminations, np.bool_),
                truncations=np.asarray(found.truncations, np.bool_),
                outcome=metadata.get(CARD),
            )
        return checked_episode(episode, place)

    def _opened(self, folder: Path) -> "MinariDataset":
        try:
            from minari import MinariDataset
        except ImportError as error:
            raise DatasetError(f"{folder} needs Minari; install the extra: pip install 'laploop[learning]'") from error
        with refusing_damage(f"{folder / _METADATA}", REMEDY):
            return MinariDataset(folder)


def _by_key(observations: Any) -> Observations:
    return observations if isinstance(observations, dict) else {VECTOR: observations}
