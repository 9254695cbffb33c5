"""What a data set says of itself."""

from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import JsonValue

from laploop.configuration import configuration, from_plain, to_plain
from laploop.envs.learning.encoding import DEPTH_FAR_MM, DEPTH_NEAR_MM
from laploop.envs.learning.learner_env import LearnerEnv
from laploop.envs.learning.options import LearnerOptions
from laploop.envs.tasks.registry import TASKS, environment_id
from laploop.errors import DatasetError, LaploopError
from laploop.studies.code_digest import code_digest
from laploop.studies.demonstrations.config import DemonstrationConfig
from laploop.studies.demonstrations.damage import REMEDY

LAYOUT = 1
"""Of the card; raised when earlier cards can no longer be read."""


@configuration
class Card:
    """Everything with which the episodes can be made again; plain data."""

    laploop: str
    """Version that made them."""
    task: str
    environment: str
    """Gymnasium's id."""
    keywords: dict[str, Any]
    """What `gymnasium.make` is given beside it."""
    instruction: str
    """The task in words."""
    decision_period_ms: float
    action_scale: float
    """What an action of 1 stands for, m/s."""
    entries: dict[str, list[int]]
    """Of the observed vector: begin and end by name."""
    depth_range_mm: tuple[float, float]
    """Depths of the grey values 1 and 255."""
    expert: dict[str, Any]
    """Controller, its configuration, the estimator it used, and what led it off its path."""
    keep: str
    code: str = ""
    """Hash of the code that made them, which changes within a version; empty in earlier data sets."""
    layout: int = LAYOUT

    @classmethod
    def of(cls, config: DemonstrationConfig, keep: str, env: LearnerEnv, expert: Mapping[str, Any]) -> "Card":
        """Describe the episodes of an environment and an expert."""
        return cls(
            laploop=version("laploop"),
            task=config.task,
            environment=environment_id(config.task, 1),
            keywords=config.keywords,
            instruction=(type(env).__doc__ or config.task).strip().partition("\n")[0],
            decision_period_ms=config.environment.decision_period_ms,
            action_scale=env.action_scale,
            entries={name: [part.start, part.stop] for name, part in env.layout.slices.items()},
            depth_range_mm=(DEPTH_NEAR_MM, DEPTH_FAR_MM),
            expert={
                **expert,
                "estimator": type(env.task_env.loop.estimator).__name__,
                "perturbation": to_plain(config.perturbation),
            },
            keep=keep,
            code=code_digest("demonstrations"),
        )

    @classmethod
    def read(cls, plain: object, place: Path) -> "Card":
        """Make a card from what a data set holds.

        Raises:
            DatasetError: If it is none, of another layout, damaged, or of another version of laploop.
            UnknownNameError: If there is no such task.
        """
        if not isinstance(plain, Mapping) or "laploop" not in plain:
            raise DatasetError(f"{place} does not hold demonstrations; `laploop demonstrate` writes them")
        if plain["laploop"] != version("laploop"):
            made = f"{place} was made by laploop {plain['laploop']}, this is {version('laploop')}"
            raise DatasetError(f"{made}; episodes come out the same with the version that made them alone; {REMEDY}")
        if (layout := plain.get("layout")) != LAYOUT:
            raise DatasetError(f"the card of {place} has the layout {layout!r}; allowed: {LAYOUT}; {REMEDY}")
        try:
            card = from_plain(cls, plain)
        except LaploopError as error:
            raise DatasetError(f"the card of {place} is damaged: {error}; {REMEDY}") from error
        TASKS.check(card.task)
        return card

    @property
    def plain(self) -> dict[str, JsonValue]:
        """As JSON has it."""
        return to_plain(self)

    def config(self) -> DemonstrationConfig:
        """Return what was demonstrated, as far as it makes an environment.

        Raises:
            DatasetError: If a keyword is not allowed.
        """
        keywords = dict(self.keywords)
        given = {name: keywords.pop(name) for name in ("perception", "randomisation") if name in keywords}
        try:
            return DemonstrationConfig(task=self.task, environment=LearnerOptions(**keywords), **given)
        except LaploopError as error:
            raise DatasetError(f"the keywords of the data set are not allowed: {error}") from error
