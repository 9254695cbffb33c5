"""The keywords of `gymnasium.make`."""

from dataclasses import fields, replace
from typing import Annotated, Any, Literal, TypeVar

from laploop.configuration import Field, configuration
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.fidelity import FidelityName
from laploop.envs.randomisation.randomisation import Randomisation
from laploop.envs.tasks.task_config import DEPTH_MODES, ObservationMode, TaskConfig
from laploop.envs.theatre.organ_motion import MotionName
from laploop.errors import InvalidValueError, UnknownNameError

ObservationName = Literal["state", "depth", "stripes", "depth+state"]
ActionName = Literal["tip-velocity", "joint-velocity", "residual"]
RewardName = Literal["dense", "sparse"]
ViewName = Literal["scope", "overview", "both"]

ConfigT = TypeVar("ConfigT", bound=TaskConfig)

KEYWORD_PATHS: dict[str, tuple[str, ...]] = {
    "motion": ("loop.theatre.motion",),
    "latency_ms": ("loop.timing.service",),
    "fidelity": ("loop.physics_hz", "loop.theatre.tissue.contact_every"),
}
"""Paths of a task's configuration that keywords set, without those that all episodes share."""

TASK_OBSERVATION: dict[str, ObservationMode] = {
    "state": "state",
    "depth": "depth",
    "stripes": "stripes",
    "depth+state": "depth",
}
"""What the task itself has to observe for each observation; what nobody observes is not rendered."""


@configuration
class LearnerOptions:
    """What people change most of a task to be learned; what is None stays as it is in the task's configuration."""

    observation: ObservationName = "state"
    """What is observed: state (the simulator's truth), depth, stripes (an image, with the robot's own senses), depth+state."""
    reward: RewardName = "dense"
    """dense (progress, success, small penalties), or sparse (1 in the step that solves the task)."""
    decision_period_ms: Annotated[float, Field(gt=0.0, le=1000.0)] = 40.0
    """From one action to the next, simulated; a whole number of control periods. 40 ms is a frame of a camera of 25 Hz."""
    render_view: ViewName = "both"
    """What `rgb_array` shows: what the scope sees, the theatre from the side, or both side by side."""
    action: ActionName | None = None
    """What an action means: tip-velocity (the default), joint-velocity, residual (adds to the scripted controller)."""
    motion: MotionName | None = None
    """How the tissue moves: still, breathing, beating, or both; by default the task's own."""
    latency_ms: float | None = None
    """From the capture of a frame to its depth, simulated; 40 ms by default."""
    fidelity: FidelityName | None = None
    """What the simulation may cost: full (the default), or fast (for learning: about half)."""


def learner_options(others: tuple[str, ...], **keywords: Any) -> LearnerOptions:
    """Return the options of keywords; `others` are keywords that the environment takes besides.

    Raises:
        UnknownNameError: If there is no such keyword; the message names the nearest.
        LaploopError: If a value is not allowed.
    """
    known = [field.name for field in fields(LearnerOptions)]
    for name in keywords:
        if name not in known:
            raise UnknownNameError("keyword", name, [*known, *others])
    return LearnerOptions(**keywords)


def applied(options: LearnerOptions, config: ConfigT, *, strict: bool) -> ConfigT:
    """Return a task's configuration with the options in place.

    Args:
        options: The options.
        config: The configuration.
        strict: Whether the configuration is the user's own, which no option may contradict.

    Raises:
        InvalidValueError: If one does, or a value is not allowed.
    """
    changes: dict[str, dict[str, Any]] = {
        "action": {"action_mode": options.action},
        "motion": {"motion": options.motion},
        "latency_ms": {"perception_latency_ms": options.latency_ms},
        "fidelity": {"fidelity": options.fidelity},
    }
    result = config
    for keyword, change in changes.items():
        value = getattr(options, keyword)
        if value is None:
            continue
        changed = replace(result, **change) if keyword == "action" else EpisodeConfig(task=result).changed(**change).task
        if strict and changed != result:
            raise InvalidValueError(keyword, value, "none that contradicts config; change it there")
        result = changed  # type: ignore[assignment]
    return replace(result, observation_mode=TASK_OBSERVATION[options.observation])


def check_not_drawn(options: LearnerOptions, randomisation: Randomisation) -> None:
    """Check that a randomisation leaves alone what the options set.

    Raises:
        InvalidValueError: If it draws the path of an option that was given; the message names both.
    """
    for keyword, paths in KEYWORD_PATHS.items():
        value = getattr(options, keyword)
        drawn = next((found for path in paths if (found := randomisation.drawn_at(path)) is not None), None)
        if value is not None and drawn is not None:
            remedy = f"leave {keyword} out, or give a randomisation without that path"
            raise InvalidValueError(keyword, value, f"none where the randomisation draws {drawn}; {remedy}")


def uses_depth(config: TaskConfig) -> bool:
    """Return whether anything in an environment with this configuration looks at depth maps."""
    return config.observation_mode in DEPTH_MODES or config.action_mode == "residual"


def decision_ticks(options: LearnerOptions, config: TaskConfig) -> int:
    """Return the number of control periods from one action to the next.

    Raises:
        InvalidValueError: If it is not a whole one.
    """
    period_ns, control_ns = round(options.decision_period_ms * 1e6), config.loop.control_ns
    if period_ns % control_ns or period_ns < control_ns:
        allowed = f"a multiple of the control period, {control_ns * 1e-6:g} ms"
        raise InvalidValueError("decision_period_ms", options.decision_period_ms, allowed)
    return period_ns // control_ns
