"""What an episode is: one tree of configuration, and the few options that people change most."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, JsonValue, PlainValidator, SerializeAsAny
from pydantic_core import PydanticCustomError

from laploop.configuration import Field, configuration, from_plain, merged, to_plain
from laploop.control.controllers.registry import CONTROLLERS
from laploop.control.prediction.registry import PREDICTORS
from laploop.envs.fidelity import FidelityName, with_fidelity
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, TraceLatency
from laploop.envs.sensors.optics.presets import PresetName, optics_preset
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.optics.tissue_classes import TissueClassName, tissue_material
from laploop.envs.tasks.registry import TASKS, default_config, task_spec
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.theatre.actuation import ActuationConfig, ActuationName
from laploop.envs.theatre.organ_motion import BaseMotion, MotionName
from laploop.envs.theatre.trocar import TrocarConfig, TrocarName
from laploop.envs.timing_presets import timing_preset
from laploop.errors import InvalidValueError
from laploop.perception.estimators.registry import ESTIMATORS

OWN = "own"
"""Name of the task's own controller, and of the controller's own predictor."""

T = TypeVar("T")


def _finite(value: JsonValue) -> JsonValue:
    """Refuse what JSON does not know: a configuration goes through files."""
    try:
        json.dumps(value, allow_nan=False)
    except ValueError:
        raise PydanticCustomError("plain", "plain data whose numbers are finite") from None
    return value


PlainArguments = Annotated[dict[str, JsonValue], AfterValidator(_finite)]
"""Arguments of a user's object, by name."""


@configuration
class PerceptionConfig:
    """The depth estimator."""

    name: str = "compact"
    """compact (network), phase (classical demodulation), oracle (exact depth), another network, or module:Class."""
    weights: Path | None = None
    """Weights file (.safetensors) of a network, in place of the shipped one."""
    arguments: PlainArguments = Field(default_factory=dict)
    """Further arguments of the estimator, by name."""

    def __post_init__(self) -> None:
        ESTIMATORS.check(self.name)


@configuration
class ControllerConfig:
    """Who commands the tip."""

    name: str = OWN
    """own (the task's scripted controller), the name of another, or module:Class."""
    arguments: PlainArguments = Field(default_factory=dict)
    """Further arguments of the controller, by name; of a scripted one, fields of its configuration."""

    def __post_init__(self) -> None:
        if self.name != OWN:
            CONTROLLERS.check(self.name)


@configuration
class PredictorConfig:
    """How a scripted controller bridges the age of the depth."""

    name: str = OWN
    """own (rate for reach, rhythms for the others), none (holds the newest measurement), rate (extrapolates at the latest
    rate), rhythms (learns breathing and heartbeat), or module:Class."""
    arguments: PlainArguments = Field(default_factory=dict)
    """Further arguments of the predictor, by name."""

    def __post_init__(self) -> None:
        if self.name != OWN:
            PREDICTORS.check(self.name)
        elif self.arguments:
            raise InvalidValueError("arguments", self.arguments, "none with the controller's own predictor; name one")


def _task(value: object) -> TaskConfig:
    """Take the configuration of a task as it is, or as a file holds it; its field `kind` names the task."""
    if isinstance(value, Mapping):
        kind = value.get("kind", "reach")
        if not isinstance(kind, str):
            raise InvalidValueError("kind", kind, f"the name of a task: {', '.join(TASKS.names())}")
        return from_plain(task_spec(kind).config_class, value)
    if not isinstance(value, TaskConfig) or not isinstance(value, task_spec(value.kind).config_class):
        raise PydanticCustomError("task", "the configuration of a task")
    return value


@configuration
class EpisodeConfig:
    """An episode: the task with its loop and theatre, the estimator, the controller, and the seed.

    Equal configurations make equal episodes, to the bit, on the same machine.
    """

    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    """Decides the tissue, the target and all noise."""
    perception: PerceptionConfig = Field(default_factory=PerceptionConfig)
    controller: ControllerConfig = Field(default_factory=ControllerConfig)
    predictor: PredictorConfig = Field(default_factory=PredictorConfig)
    # A controller that fails must not bring the arm's loop down.
    task: Annotated[SerializeAsAny[TaskConfig], PlainValidator(_task)] = Field(
        default_factory=lambda: default_config("reach", bad_action="hold")
    )
    """What to do, and where."""

    @classmethod
    def of(cls, **options: Any) -> "EpisodeConfig":
        """Make an episode from the options of `EpisodeOptions`, as `of(task="track", motion="both", seconds=14.0)`.

        Raises:
            LaploopError: If there is no such option, or a value is not allowed.
        """
        return EpisodeOptions(**options).episode()

    def changed(self, **options: Any) -> "EpisodeConfig":
        """Return the episode with options of `EpisodeOptions` changed.

        Raises:
            LaploopError: If there is no such option, or a value is not allowed.
        """
        return EpisodeOptions(**options).applied_to(self)

    def with_plain(self, plain: Mapping[str, Any], *, source: str = "") -> "EpisodeConfig":
        """Return the episode with what a file holds, in the layout of this class, in place of its own.

        Raises:
            LaploopError: If there is no such field, or a value is not allowed; `source` says where it comes from.
        """
        return from_plain(EpisodeConfig, merged(to_plain(self), plain), source=source)

    def motion_name(self) -> str:
        """Return how the tissue moves: still, breathing, beating, both, or custom."""
        return _name_of(self.task.loop.theatre.motion, BaseMotion, get_args(MotionName))

    def actuation_name(self) -> str:
        """Return how the arms follow their targets: ideal, ur5-cb, ur5-e, or custom."""
        return _name_of(self.task.loop.theatre.actuation, ActuationConfig, get_args(ActuationName))


@configuration
class EpisodeOptions:
    """The options of an episode that people change most; what is left out stays as it is."""

    task: str | None = None
    """What to do: reach (touch a point that was chosen in the first frame; the default), track (hold 3 mm above it), palpate
    (press on it with 0.5 N), scan (follow a line drawn in the first frame), look (keep a point in the middle of the view), or
    module:SPEC."""
    perception: str | None = None
    """Depth estimator: compact (network; the default), phase (classical demodulation), oracle (exact depth), another network,
    or module:Class."""
    weights: Path | None = None
    """Weights file (.safetensors) of a network, in place of the shipped one."""
    controller: str | None = None
    """Who commands the tip: own (the task's scripted controller; the default), the name of another, or module:Class."""
    prediction: str | None = None
    """How the scripted controller bridges the age of the depth: none (holds the newest measurement), rate (extrapolates at the
    latest rate), rhythms (learns breathing and heartbeat), or module:Class. By default rate for reach, rhythms otherwise."""
    optics: PresetName | None = None
    """Light, surfaces and sensor: paper (the laparoscope that the simulator follows; the default), ideal, worst."""
    tissue_class: TissueClassName | None = None
    """How bright the tissue is and how it spreads light: bowel, stomach, liver, fat. By default as bright as bowel, with a
    Gaussian spot; the LED's power stays as it is."""
    motion: MotionName | None = None
    """How the tissue moves: still, breathing (10 mm, 0.25 Hz), beating (1 mm, 1.2 Hz), or both. By default the task's own: both
    for track, breathing for look, still for the others."""
    seed: Annotated[int, Field(ge=0, lt=2**31)] | None = None
    """Decides the tissue, the target and all noise; 0 by default."""
    seconds: float | None = None
    """Simulated time after which the episode ends: by default 10 s for reach and look, 15 palpate, 20 track, 30 scan."""
    hold_s: float | None = None
    """How long to hold until the episode ends as a success: within 1.5 mm of an ideal touch without a break for reach (by
    default 0.3 s), within 0.1 N of 0.5 N for 95 % of the time for palpate (3 s)."""
    actuation: ActuationName | None = None
    """How the arms follow their joint targets: ideal (the default), ur5-cb (125 Hz, 35 ms delay, 30 ms lag), ur5-e (500 Hz, 34
    and 20 ms)."""
    trocar: TrocarName | None = None
    """What the wall and the seal of each trocar do to the shaft: lubricated (2 N/mm, 0.75 N of friction; the default), dry
    (8 N), none."""
    timing: str | None = None
    """How late things are: paper, masknet, da-vinci-s-147, umi-ur5, xu-2014-500, ... (`laploop presets` lists them), or
    module:PRESET; the options that follow change single stages of it."""
    perception_latency_ms: float | None = None
    """From the arrival of a frame at the estimator to that of its depth, in simulated time; 40 ms by default."""
    latency_trace: Path | None = None
    """CSV file with a column latency_ms, as `laploop speed` writes it, replayed as the perception latency."""
    compute_trace: Path | None = None
    """Likewise, replayed as the controllers' computing times."""
    transfer_latency_ms: float | None = None
    """From the capture of a frame to its arrival at the estimator; comes on top of the perception latency, but does not keep
    the estimator busy. 0 ms by default."""
    fidelity: FidelityName | None = None
    """What the simulation may cost: full (physics steps of 2 ms; the default), or fast (4 ms, and contacts feel every other
    sample of the tissue's top)."""
    phantom: Path | None = None
    """Closed surface to be the tissue instead of a seeded one: .stl, .obj or .ply, millimetres, z up, 20-200 mm a side."""

    def episode(self) -> EpisodeConfig:
        """Return the default episode of the task with these options in place.

        Raises:
            LaploopError: If a value is not allowed.
        """
        # A controller that fails must not bring the arm's loop down.
        return self.applied_to(EpisodeConfig(task=default_config(self.task or "reach", bad_action="hold")))

    def applied_to(self, episode: EpisodeConfig) -> EpisodeConfig:
        """Return an episode with these options in place; reads phantom and traces where they are given.

        Raises:
            LaploopError: If a value is not allowed, or a file does not exist or is damaged.
        """
        task = episode.task
        if self.task not in {None, task.kind}:
            raise InvalidValueError("task", self.task, f"{task.kind}, as in the rest of the configuration")
        if self.hold_s is not None and not task_spec(task.kind).holds:
            holding = [name for name in TASKS.names() if task_spec(name).holds]
            raise InvalidValueError("hold_s", self.hold_s, f"only with the tasks {' and '.join(holding)}")
        theatre = _with(
            task.loop.theatre,
            motion=None if self.motion is None else BaseMotion.named(self.motion),
            actuation=None if self.actuation is None else ActuationConfig.named(self.actuation),
            trocar=None if self.trocar is None else TrocarConfig.named(self.trocar),
            tissue=None if self.phantom is None else replace(task.loop.theatre.tissue, mesh=self.phantom),
        )
        loop = task.loop if self.timing is None else timing_preset(self.timing).applied_to(task.loop)
        loop = _with(
            loop,
            theatre=theatre,
            optics=self._optics(loop.optics),
            timing=self._timing(loop.timing),
        )
        task = _with(task, loop=loop, max_seconds=self.seconds, success_hold_s=self.hold_s)
        perception = episode.perception if self.perception is None else PerceptionConfig(name=self.perception)
        return _with(
            episode,
            seed=self.seed,
            perception=_with(perception, weights=self.weights),
            controller=None if self.controller is None else ControllerConfig(name=self.controller),
            predictor=None if self.prediction is None else PredictorConfig(name=self.prediction),
            task=task if self.fidelity is None else with_fidelity(task, self.fidelity),
        )

    def _optics(self, optics: StripeOptics) -> StripeOptics:
        chosen = optics if self.optics is None else optics_preset(self.optics)
        if self.tissue_class is None:
            return chosen
        tissue = tissue_material(self.tissue_class, surface=chosen.tissue, wavelength_m=chosen.wavelength_m)
        return replace(chosen, tissue=tissue)

    def _timing(self, timing: TimingConfig) -> TimingConfig:
        if None not in {self.latency_trace, self.perception_latency_ms}:
            allowed = "none where a latency trace is given"
            raise InvalidValueError("perception_latency_ms", self.perception_latency_ms, allowed)
        return _with(
            timing,
            service=_constant(self.perception_latency_ms) or _trace(self.latency_trace),
            transfer=_constant(self.transfer_latency_ms),
            compute=_trace(self.compute_trace),
        )


def _constant(latency_ms: float | None) -> ConstantLatency | None:
    return None if latency_ms is None else ConstantLatency(latency_ms=latency_ms)


def _trace(path: Path | None) -> TraceLatency | None:
    return None if path is None else TraceLatency.from_csv(path)


def _with(config: T, **changes: Any) -> T:
    """Return a configuration with those fields changed that have a value."""
    given = {name: value for name, value in changes.items() if value is not None}
    return replace(config, **given) if given else config  # type: ignore[type-var]


def _name_of(value: object, kind: type[BaseMotion] | type[ActuationConfig], names: tuple[str, ...]) -> str:
    return next((name for name in names if kind.named(name) == value), "custom")
