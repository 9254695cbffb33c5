"""Steps an environment along the recorded actions of an episode, and compares what it tells with what was recorded."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from laploop.envs.recording.recorder import Recorder
from laploop.errors import DatasetError, InvalidValueError
from laploop.studies.demonstrations.demonstration import make_learner, one_thread, stacked
from laploop.studies.demonstrations.recorded import RecordedDemonstrations, RecordedEpisode


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Something that is not, to the bit, what was recorded."""

    frame: int
    """0 is the reset, n the decision n."""
    what: str
    """Key of the observation, `reward`, `terminated`, `truncated`, or `randomisation`."""
    entries: int
    """How many of its numbers differ."""
    largest: float
    """Largest distance of such a number from the recorded one."""


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What became of an episode."""

    frames: int
    """Observations that were compared."""
    differences: tuple[Difference, ...]

    @property
    def differing_frames(self) -> int:
        """How many frames differ in anything."""
        return len({one.frame for one in self.differences})


def replay(
    demonstrations: RecordedDemonstrations,
    index: int,
    *,
    recorder: Recorder | None = None,
    render_mode: str | None = None,
    trust: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Replay:
    """Replay an episode.

    Args:
        demonstrations: The data set.
        index: Of the episode, from 0 on.
        recorder: Receives everything that happens; whoever made it closes it.
        render_mode: `human` shows it in a viewer.
        trust: Whether the data set may name code, as module:Class, which is then run.
        progress: Called with the number of decisions so far.

    Raises:
        DatasetError: If the data set does not fit its environment.
        InvalidValueError: If there is no such episode, or the data set names code without `trust`.
    """
    card = demonstrations.card
    perception = str(card.keywords.get("perception", ""))
    if not trust and ":" in perception:
        raise InvalidValueError("perception of the data set", perception, "no module:Class from a data set without --trust")
    episode = demonstrations.episode(index)
    one_thread()
    env, _ = make_learner(card.config(), recorder=recorder, render_mode=render_mode)
    differences: list[Difference] = []
    try:
        if episode.actions.shape[1:] != env.action_space.shape:
            raise DatasetError(f"actions of {episode.actions.shape[1:]} numbers do not fit {card.environment}")
        observed, info = env.reset(seed=episode.outcome["seed"])
        if info["randomisation"] != episode.outcome["randomisation"]:
            differences.append(Difference(frame=0, what="randomisation", entries=1, largest=float("nan")))
        differences += _compared(0, observed, episode)
        frames = 1
        for number, action in enumerate(episode.actions):
            observed, reward, terminated, truncated, _ = env.step(action)
            told = {"reward": episode.rewards.dtype.type(reward), "terminated": terminated, "truncated": truncated}
            recorded = {
                "reward": episode.rewards[number],
                "terminated": episode.terminations[number],
                "truncated": episode.truncations[number],
            }
            found = [*_compared(number + 1, observed, episode), *_different(number + 1, told, recorded)]
            differences += found
            frames += 1
            if progress is not None:
                progress(number + 1)
            if terminated or truncated:
                break
        if frames <= len(episode.actions):
            differences.append(Difference(frame=frames, what="end", entries=1, largest=float("nan")))
    finally:
        env.close()
    return Replay(frames=frames, differences=tuple(differences))


def _compared(frame: int, observed: Any, episode: RecordedEpisode) -> list[Difference]:
    """Compare an observation with the recorded one, where the format has it."""
    now = {key: array[0] for key, array in stacked([observed]).items()}
    if now.keys() != episode.observations.keys():
        raise DatasetError(f"observations {', '.join(episode.observations)} do not fit the environment's {', '.join(now)}")
    recorded = {key: array[frame] for key, array in episode.observations.items() if frame < len(array)}
    return _different(frame, {key: now[key] for key in recorded}, recorded)


def _different(frame: int, told: Mapping[str, Any], recorded: Mapping[str, Any]) -> list[Difference]:
    found = []
    for what, before in recorded.items():
        one, other = np.asarray(told[what]), np.asarray(before)
        if one.shape != other.shape or one.dtype != other.dtype:
            raise DatasetError(
                f"{what} is {other.dtype} of shape {other.shape} in the data set, {one.dtype} of {one.shape} in the environment"
            )
        unequal = np.frombuffer(one.tobytes(), np.uint8) != np.frombuffer(other.tobytes(), np.uint8)
        if unequal.any():
            distances = np.abs(one.astype(np.float64) - other.astype(np.float64))
            entries = int(unequal.reshape(one.size, -1).any(axis=1).sum())
            found.append(Difference(frame=frame, what=what, entries=entries, largest=float(np.nanmax(distances))))
    return found
