"""What all scripted controllers have in common."""

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic, Self, TypeVar

from laploop.arrays import Array
from laploop.configuration import Field, configuration, from_plain, merged, to_plain
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.safe_approach import SafeApproach, SafeApproachConfig
from laploop.control.messages import ControlInput
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.targeting.targeting import Target, Targeting, TargetingConfig
from laploop.perception.geometry import Rig


@configuration
class TaskControllerConfig:
    """What every scripted controller needs to know."""

    targeting: TargetingConfig = Field(default_factory=lambda: TargetingConfig(prediction="rhythms"))
    """How the target is followed."""


@configuration
class ApproachControllerConfig(TaskControllerConfig):
    """What a controller needs to know whose tool goes to a stand-off first."""

    approach: SafeApproachConfig = Field(default_factory=SafeApproachConfig)
    """The way there, and what makes the tool withdraw."""


ConfigT = TypeVar("ConfigT", bound=TaskControllerConfig)
ApproachConfigT = TypeVar("ApproachConfigT", bound=ApproachControllerConfig)


class TaskController(ABC, Generic[ConfigT]):
    """A `TipController` that follows a target."""

    config_class: ClassVar[type[Any]]
    """Made when no configuration is given."""

    def __init__(self, rig: Rig, config: ConfigT | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry.

        Args:
            rig: The camera and its projector.
            config: Of the class's own kind.
            predictor: Used in place of the one that `config.targeting` names.
        """
        self._config: ConfigT = config if config is not None else self.config_class()
        self._rig = rig
        self._targeting = Targeting(rig, self._config.targeting, predictor)
        self._set_up()
        self.reset()

    @classmethod
    def of(cls, rig: Rig, *, predictor: MotionPredictor | None = None, **fields: Any) -> Self:
        """Make a controller from the fields of its configuration, nested ones as mappings."""
        return cls(rig, from_plain(cls.config_class, merged(to_plain(cls.config_class()), fields)), predictor)

    @property
    @abstractmethod
    def phase(self) -> Phase:
        """What the controller is doing."""

    @property
    def config(self) -> ConfigT:
        """What it was made with."""
        return self._config

    @property
    def target(self) -> Target | None:
        """What is known of the target, from the last tick."""
        return self._target

    @property
    def depth_jump_fraction(self) -> float:
        """Fraction of the target's surroundings whose depth jumped in the newest frame and was rejected."""
        return self._targeting.jumped_fraction

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        self._targeting.reset()
        self._target: Target | None = None
        self._last_ns: int | None = None

    @abstractmethod
    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame."""

    def _set_up(self) -> None:
        """Make the parts that the configuration describes."""

    def _elapsed_s(self, state: ControlInput) -> float:
        """Return the time since the last tick, 0 at the first."""
        elapsed = 0.0 if self._last_ns is None else (state.now_ns - self._last_ns) * 1e-9
        self._last_ns = state.now_ns
        return elapsed


class ApproachController(TaskController[ApproachConfigT]):
    """A controller whose tool is brought to a stand-off by `SafeApproach`, and taken back by it when something is wrong.

    Too much force, a lost target and readings that are not numbers are the approach's business; the task works in between.
    """

    @property
    def phase(self) -> Phase:
        """What the controller is doing."""
        return self._approach.phase if self._phase is None else self._phase

    @property
    def alarm(self) -> bool:
        """Whether the alarm force has been read since `reset`."""
        return self._approach.alarm

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        super().reset()
        self._approach.reset()
        self._leave()

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame."""
        elapsed = self._elapsed_s(state)
        self._target = self._aim(state)
        way = self._advance(state, self._target)
        if not isinstance(way, ApproachGeometry):
            self._leave()
            return way
        return self._config.approach.motion.bounded(self._work(state, way, elapsed))

    def _set_up(self) -> None:
        self._approach = SafeApproach(self._config.approach)

    def _aim(self, state: ControlInput) -> Target | None:
        """Return where to go."""
        return self._targeting.update(state)

    def _advance(self, state: ControlInput, target: Target | None) -> Array | ApproachGeometry:
        """Let the approach judge; return its velocity (3,), or this tick's geometry when the task may work."""
        return self._approach.advance(state, target)

    def _leave(self) -> None:
        """Forget how far the task's work has come: the approach has taken over."""
        self._phase: Phase | None = None

    @abstractmethod
    def _work(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        """Return the velocity (3,) of the task's own work; `_phase` is None when it begins."""
