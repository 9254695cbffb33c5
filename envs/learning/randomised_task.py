"""The environment of a task whose configuration may differ from episode to episode."""

from dataclasses import dataclass
from functools import partial
from typing import Any

from laploop.control.messages import TipController
from laploop.envs.environment_state import EnvironmentState
from laploop.envs.learning.options import LearnerOptions, check_not_drawn
from laploop.envs.randomisation.files import RandomisationLike, randomisation_of
from laploop.envs.randomisation.randomisation import Randomisation, Values, checked_width, with_values
from laploop.envs.recording.recorder import Recorder
from laploop.envs.tasks.registry import make_environment
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import InvalidValueError, LaploopError
from laploop.perception.estimators.base import DepthEstimator


@dataclass(frozen=True, kw_only=True)
class TaskParts:
    """What a task's environment is made of besides its configuration."""

    name: str
    perception: str | DepthEstimator
    options: LearnerOptions
    """What was chosen by keyword, which no randomisation may draw."""
    recorder: Recorder | None = None
    controller: TipController | None = None


class RandomisedTask:
    """Makes a task's environment, and makes it anew where an episode's configuration is another than the last one's.

    Attributes:
        env: The environment of the newest configuration.
    """

    def __init__(self, config: TaskConfig, parts: TaskParts, randomisation: RandomisationLike) -> None:
        """Make the environment of the nominal configuration; raises as `randomise`."""
        self._nominal = config
        self._perception = parts.perception
        self._options = parts.options
        self._make = partial(make_environment, parts.name, recorder=parts.recorder, controller=parts.controller)
        self._shares_cores = False
        self._randomisation = Randomisation({})
        self.randomise(randomisation)
        self.env: TaskEnv[Any] = self._make(config=config, perception=parts.perception)

    def randomise(self, randomisation: RandomisationLike | None = None, width: float = 1.0) -> None:
        """Set what following episodes differ in, and how far; without a randomisation, that stays as it is.

        Raises:
            UnknownNameError: If there is no such level, distribution or path.
            LaploopError: If a value is not allowed, or a path is drawn that a keyword sets.
        """
        width = checked_width(width)
        if randomisation is not None:
            chosen = randomisation_of(randomisation)
            check_not_drawn(self._options, chosen)
            chosen.check(self._nominal)
            if chosen.changes_scope and not isinstance(self._perception, str):
                allowed = "the name of an estimator where the scope is randomised, so that it can be made for each"
                raise InvalidValueError("perception", type(self._perception).__name__, allowed)
            self._randomisation = chosen
        self._width = width

    @property
    def is_random(self) -> bool:
        """Whether anything is drawn."""
        return bool(self._randomisation.distributions) and self._width > 0.0

    def share_cores(self) -> None:
        """Leave the other cores to other environments, in episodes of other configurations, too."""
        self._shares_cores = True
        self.env.share_cores()

    def resume(self, state: EnvironmentState) -> None:
        """Make the environment of the episode that a state is of, if any is drawn here.

        Raises:
            InvalidValueError: If the state is of another task or estimator, or observes something else.
        """
        if self.is_random:
            state.check(**{**self.env.identity(), "config": state.config})
            self._apply(state.config)

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: not the recorder."""
        make = partial(self._make.func, *self._make.args, **{**self._make.keywords, "recorder": None})
        return vars(self) | {"_make": make}

    def draw(self, seed: int) -> Values:
        """Draw an episode's configuration, and return what was drawn.

        Raises:
            LaploopError: If values that are allowed one by one are not allowed together.
        """
        values = self._randomisation.draw(self._nominal, seed, self._width)
        try:
            self._apply(with_values(self._nominal, values))
        except LaploopError as error:
            raise error.at(f"randomisation of seed {seed}", ": ") from None
        return values

    def _apply(self, config: TaskConfig) -> None:
        before = self.env
        if config == before.config:
            return
        same_scope = config.loop.theatre.scope == before.config.loop.theatre.scope
        # Making an estimator may take as long as an episode's first second.
        env = self._make(config=config, perception=before.loop.estimator if same_scope else self._perception)
        # States and copies of all episodes know the estimator alike.
        env.perception = self._perception
        if env.observation_space != before.observation_space:
            raise InvalidValueError("observation space", env.observation_space, "that of the nominal task")
        env.np_random = before.np_random
        env.loop.timing_changes = before.loop.timing_changes
        if self._shares_cores:
            env.share_cores()
        before.close()
        self.env = env
