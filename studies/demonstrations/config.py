"""What is demonstrated."""

import hashlib
import json
from importlib.metadata import version
from typing import Annotated, Any, Literal

from pydantic import JsonValue

from laploop.configuration import Field, Seed, Workers, configuration, to_plain
from laploop.envs.learning.options import LearnerOptions, check_not_drawn
from laploop.envs.randomisation.files import randomisation_of
from laploop.envs.tasks.registry import TASKS
from laploop.errors import InvalidValueError
from laploop.perception.estimators.registry import check_estimator
from laploop.studies.code_digest import code_digest

Seconds = Annotated[float, Field(gt=0.0, le=60.0)]
KeepName = Literal["success", "all"]


@configuration
class CollectionConfig:
    """How many episodes of which kind."""

    episodes: Annotated[int, Field(ge=1, le=1_000_000)] = 50
    """Episodes in the data set."""
    keep: KeepName = "success"
    """Which episodes get into the data set: those in which the expert succeeded, for which further seeds are tried, or all."""
    seed: Seed = 0
    """Of the first episode; each further one has the next."""
    workers: Workers = 1
    """Processes that run episodes at the same time; the data set does not depend on their number."""


@configuration
class Perturbation:
    """What leads the expert off its path, so that the data show how it finds back.

    Each episode draws how much of it there is, from none on. The sizes are our choice: a push moves the instrument by about
    10 mm.
    """

    noise: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1
    """Largest standard deviation of the noise on each component of an action, whose bound is 1."""
    noise_s: Seconds = 0.2
    """Time constant of the noise."""
    pushes: Annotated[int, Field(ge=0, le=100)] = 2
    """Largest number of pushes: for a moment a push takes the place of the expert's action."""
    push: Annotated[float, Field(ge=0.0, le=1.0)] = 0.6
    """Size of the action that is a push."""
    push_s: Seconds = 0.3
    """How long it lasts."""
    push_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.4
    """Pushes begin in this first part of the longest time that an episode may take, so that there is time to find back."""


@configuration
class DemonstrationConfig:
    """A task, its environment, and what leads the expert off its path; with a seed it makes one episode, to the bit."""

    task: str
    """The task."""
    environment: LearnerOptions = Field(default_factory=LearnerOptions)
    perception: str | None = None
    """Depth estimator of environment and expert; by default the environment's own: compact where depth is observed, exact
    depth elsewhere."""
    randomisation: dict[str, JsonValue] = Field(default_factory=dict)
    """What differs between episodes, by path, as a file has it."""
    perturbation: Perturbation = Field(default_factory=Perturbation)

    def __post_init__(self) -> None:
        TASKS.check(self.task)
        if ":" in self.task:
            raise InvalidValueError("task", self.task, f"the name of a registered task: {', '.join(TASKS.names())}")
        if self.environment.action not in {None, "tip-velocity"}:
            raise InvalidValueError("action", self.environment.action, "tip-velocity, which is what the expert commands")
        if self.perception is not None:
            check_estimator(self.perception)
        check_not_drawn(self.environment, randomisation_of(self.randomisation))

    @property
    def keywords(self) -> dict[str, Any]:
        """What `gymnasium.make` is given; what is as by default is left out."""
        default, chosen = to_plain(LearnerOptions()), to_plain(self.environment)
        changed = {name: value for name, value in chosen.items() if value != default[name]}
        perception = {} if self.perception is None else {"perception": self.perception}
        return {**changed, **perception, **({"randomisation": self.randomisation} if self.randomisation else {})}

    @property
    def key(self) -> str:
        """A hash of all that decides an episode, apart from its seed: this, and the code that runs it."""
        decisive = {**to_plain(self), "version": version("laploop"), "code": code_digest("demonstrations")}
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()
