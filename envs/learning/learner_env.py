"""A task as learners want it: one frame a decision, normalised spaces, rewards of order one an episode."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.control.messages import TipController
from laploop.envs.environment_state import EnvironmentState
from laploop.envs.learning.encoding import DEPTH_FAR_MM, DEPTH_NEAR_MM
from laploop.envs.learning.observations import encoded_observation, observation_space, vector_layout
from laploop.envs.learning.options import LearnerOptions, applied, decision_ticks, learner_options, uses_depth
from laploop.envs.learning.privileged import PRIVILEGED, privileged_quantities, tip_to_target
from laploop.envs.learning.randomised_task import RandomisedTask, TaskParts
from laploop.envs.learning.render import RENDER_MODES, EpisodeView, RenderMode, joined, viewer_of
from laploop.envs.learning.rewards import SUCCESS, TIME, approach, shared_terms
from laploop.envs.randomisation.files import RandomisationLike
from laploop.envs.randomisation.randomisation import Values
from laploop.envs.recording.recorder import Recorder
from laploop.envs.tasks.actions import action_bound, action_size, scaled_action
from laploop.envs.tasks.registry import default_config, task_spec
from laploop.envs.tasks.reset_arguments import check_reset
from laploop.envs.tasks.steppable_env import Begin, Info, Step, SteppableEnv
from laploop.envs.tasks.task_config import TaskConfig
from laploop.envs.tasks.task_env import HARMS, TaskEnv
from laploop.envs.theatre.physics_call import PhysicsRun
from laploop.envs.wrappers.chain_state import ChainState, get_state, set_state
from laploop.errors import InvalidValueError, LaploopNote, SimulationError
from laploop.perception.estimators.base import DepthEstimator

_OTHER_KEYWORDS = ("config", "perception", "recorder", "controller", "render_mode", "randomisation")
_WORST_SCALARS = ("contact_force_n",)
_WORST_BY_ARM = ("rcm_error_mm", "port_force_n", "port_friction_n")

_TISSUES = 10
"""How many are tried before a reset gives up."""

Observation = Any


class LearnerEnv(SteppableEnv):
    """A task behind the interface that learners expect; one step is one decision, 40 ms by default.

    It stands around the environment of a task, `task_env`, whose actions it holds for the control periods of a decision. An
    episode that ends within a decision ends the step there.

    ## Action space

    `Box(-1, 1, (3,), float32)`, or (6,) for joint velocities; times `action_scale` it is a speed. Larger values are clipped.

    | action | meaning | `action_scale` |
    |---|---|---|
    | `tip-velocity` (default) | velocity of the moved tip along the camera's x (right), y (down), z | 0.06 m/s; look 0.03 m/s |
    | `joint-velocity` | joint velocities of the moved arm | 0.5 rad/s |
    | `residual` | velocity that is added to the scripted controller's | 0.06 m/s; look 0.03 m/s |

    ## Observation space

    | observation | space |
    |---|---|
    | `state` (default) | `Box(-5, 5, (n,), float32)`: the robot's own senses, then the simulator's truth |
    | `depth` | `Dict`: `depth`, `Box(0, 255, (256, 256, 1), uint8)`, and `proprioception`, `Box(-5, 5, (m,), float32)` |
    | `stripes` | `Dict`: `stripes`, an image of the same shape, and `proprioception` |
    | `depth+state` | `Dict`: `depth` and `state` |

    Entries of the vectors:

    | entry | size | in | scaled by |
    |---|---|---|---|
    | `tip_position`, `tip_velocity` | 3, 3 | every | 0.05 m from (0, 0, 0.09) m; 0.06 m/s |
    | `contact_force` | 3 | every | 2 N |
    | `frame_age` | 1 | every but `state` | 0.1 s |
    | `target_pixel` | 2 | every | the image to -1 to 1 |
    | what the task adds | | every | |
    | `to_target` | 3 | `state`, `depth+state` | 0.02 m |
    | `target_normal`, `tissue_velocity`, `true_force` | 3, 3, 3 | the same | 1; 0.06 m/s; 2 N |
    | `target_distance` | 1 | the same | 0.02 m |

    `layout.slices` says which part of a vector is what, `layout.decode(vector)` gives it in SI units. A grey value of
    `depth` is 0 where depth is not valid, and 1 to 255 from `depth_near_mm` to `depth_far_mm`.

    ## Rewards

    `reward="dense"`: the sum of `info["reward_terms"]`: those of `dense_terms`, and

    | term | over an episode |
    |---|---|
    | `force` | -2 x the share of time that the tip is pressed with 5 N; linear from 2 N on; palpate 2 N, from 1 N on |
    | `speed` | -0.1 x the mean square of the action |
    | `success`, `harm` | 1 once the task is solved, -1 once a safety limit is passed |

    `reward="sparse"`: 1 in the step that solves the task, 0 otherwise, so that the mean return is the rate of success.

    ## Starting state

    A tissue, a target and a place of the tip that the seed draws; the first frame has arrived.

    ## Episode end

    As the task's; `info["is_success"]` says whether it is solved.

    ## Arguments

    Those of `LearnerOptions`, and `config` (the task's whole configuration), `perception` (name of an estimator, or an object;
    by default `compact` where depth is used), `recorder`, `controller` (what `residual` adds to), `render_mode` (`rgb_array` or
    `human`), `randomisation` (what differs between episodes; `info["randomisation"]` of a reset says what was drawn).

    ## Version history

    * v1: normalised spaces, a decision a frame, rewards of order one an episode, keywords, rendering, `is_success`
    * v0: the task itself: a step a control period, quantities in SI units
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 25.0}  # noqa: RUF012  Gymnasium's own convention

    task_name: ClassVar[str | None] = None
    """The task, where a class is made for one."""
    lasting: ClassVar[frozenset[str]] = frozenset(
        {"options", "layout", "decision_ticks", "action_scale", "depth_near_mm", "depth_far_mm"}
        | {"render_mode", "_view", "_viewer", "_task"}
    )
    """Attributes that belong to no state."""

    def __init__(
        self,
        task: str | None = None,
        *,
        config: TaskConfig | None = None,
        perception: str | DepthEstimator | None = None,
        recorder: Recorder | None = None,
        controller: TipController | None = None,
        render_mode: RenderMode | None = None,
        randomisation: RandomisationLike = "none",
        **options: Any,
    ) -> None:
        """Make the environment; nothing is simulated or rendered before `reset`.

        Args:
            task: Name of the task, where the class is not made for one.
            config: The task, its loop and its theatre; by default the task's own. Options that contradict it are refused.
            perception: Name of a registered estimator, or an object with `estimate`. By default `compact` where depth is used,
                by the observation or the action `residual`, and `oracle`, which loads no network, elsewhere.
            recorder: Receives everything that happens, every control period.
            controller: What the action `residual` adds to, in place of the task's scripted controller.
            render_mode: rgb_array, or human: a Rerun viewer.
            randomisation: What differs from episode to episode: none, narrow, wide, the path of a TOML file, or what it holds.
            options: Fields of `LearnerOptions`.

        Raises:
            UnknownNameError: If there is no such keyword, task or estimator; the message names the nearest.
            InvalidValueError: If a value is not allowed, contradicts `config`, or is drawn by `randomisation` all the same, or
                `config` is another task's.
        """
        name = task or self.task_name
        if name is None:
            raise InvalidValueError("task", task, "the name of a task")
        self.options: LearnerOptions = learner_options(_OTHER_KEYWORDS, **options)
        expected = task_spec(name).config_class
        if config is not None and not isinstance(config, expected):
            raise InvalidValueError("config", type(config).__name__, f"a {expected.__name__}")
        whole = applied(self.options, config or default_config(name), strict=config is not None)
        self.decision_ticks = decision_ticks(self.options, whole)
        """Control periods a decision."""
        self.render_mode = render_mode
        self._viewer = viewer_of(render_mode)
        parts = TaskParts(
            name=name,
            perception=perception or ("compact" if uses_depth(whole) else "oracle"),
            options=self.options,
            recorder=joined(recorder, self._viewer),
            controller=controller,
        )
        self._task = RandomisedTask(whole, parts, randomisation)
        self.metadata = {**self.metadata, "render_fps": 1e3 / self.options.decision_period_ms}
        self.action_scale: float = action_bound(whole)
        """What an action of 1 stands for, m/s or rad/s."""
        self.depth_near_mm, self.depth_far_mm = DEPTH_NEAR_MM, DEPTH_FAR_MM
        """Depths of the grey values 1 and 255."""
        self.layout = vector_layout(self.options.observation, self.task_env)
        """Entries of the vector that is observed."""
        self.action_space = spaces.Box(-1.0, 1.0, (action_size(whole),), np.float32)
        self.observation_space = observation_space(self.options.observation, self.task_env, self.layout)
        self._view = EpisodeView(self.options.render_view, device=whole.loop.device)
        self._newest: Info | None = None

    @property
    def task_env(self) -> TaskEnv[Any]:
        """The task itself; of another configuration, another object."""
        return self._task.env

    @property
    def max_decisions(self) -> int:
        """Most steps that an episode has; fewer by those that the first frame takes to arrive."""
        config: TaskConfig = self.task_env.config
        return math.ceil(round(config.max_seconds * 1e9) / (config.loop.control_ns * self.decision_ticks))

    @property
    def action_check(self) -> Callable[[object], Array]:
        """See `SteppableEnv`."""
        return partial(scaled_action, config=self.task_env.config)

    @property
    def reset_options(self) -> tuple[str, ...]:
        """What `reset` takes in its options."""
        return self.task_env.reset_options

    def share_cores(self) -> None:
        """See `SteppableEnv`."""
        self._task.share_cores()

    # What a task defines.

    def dense_terms(self, before: Mapping[str, Any], after: Mapping[str, Any], fraction: float) -> dict[str, Any]:
        """Return the task's own terms of the dense reward for one control period.

        Args:
            before: What the task measured at its begin, by the keys of `TaskEnv`'s `info`.
            after: The same at its end.
            fraction: Of an episode, that it takes.
        """
        return {
            "approach": approach(after["target_error_mm"]) - approach(before["target_error_mm"]),
            "time": -TIME * fraction,
        }

    def to_target(self) -> Array:
        """Return the way from the moved tip to the target, (3,), metres along the camera's axes."""
        return tip_to_target(self.task_env)

    # What all tasks share.

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Begin:
        """See `SteppableEnv`."""
        self._note_time_limit()
        return super().reset(seed=seed, options=options)

    def resetting(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> PhysicsRun[Begin]:
        """Begin an episode of the task.

        A tissue on which the task cannot be set, such as one without room for a line, is replaced by the next one drawn.
        """
        check_reset(seed, options, self.task_env.reset_options)
        drawn = self._drawn(seed)
        observed, info = yield from self._begun_task(seed, options)
        self.seed_generator(seed)
        self._newest = info
        quantities = self._privileged()
        return self._observation(observed, quantities), {**self._info(info, {}, quantities), "randomisation": drawn}

    def set_randomisation(self, randomisation: RandomisationLike | None = None, *, width: float = 1.0) -> None:
        """Set what the episodes from the next reset on differ in, as a curriculum does.

        Args:
            randomisation: As in `__init__`; None keeps the present one.
            width: 0 to 1: scales the distance of the ends of all distributions from the nominal values.

        Raises:
            LaploopError: As from `__init__`.
        """
        self._task.randomise(randomisation, width)

    def stepping(self, action: NDArray[np.floating[Any]]) -> PhysicsRun[Step]:
        """Hold an action for a decision, or until the episode ends."""
        if self._newest is None:
            raise SimulationError("the episode has not begun; call reset() first")
        config = self.task_env.config
        command = scaled_action(action, config)
        infos = [self._newest]
        terms: dict[str, float] = {}
        for _ in range(self.decision_ticks):
            _, terminated, truncated, info = yield from self.task_env.ticking(command)
            for name, value in self._reward_terms(infos[-1], info, command / self.action_scale).items():
                terms[name] = terms.get(name, 0.0) + float(value)
            infos.append(info)
            if terminated or truncated:
                break
        self._newest = infos[-1]
        quantities = self._privileged()
        observation = self._observation(self.task_env.observation(), quantities)
        info = self._info({**infos[-1], **_worst(infos[1:])}, terms, quantities)
        return observation, float(sum(terms.values())), terminated, truncated, info

    def render(self) -> Any:
        """Return the picture that `render_view` names, (height, width, 3) uint8; None where there is nothing to return.

        Raises:
            SimulationError: If no episode has begun.
        """
        if self.render_mode != "rgb_array":
            return None
        if self._newest is None:
            raise SimulationError("there is nothing to render yet; call reset() first")
        return self._view.picture(self.task_env)

    def get_state(self) -> ChainState:
        """Return everything that shapes the future; errors as for `TaskEnv.get_state`."""
        return get_state(self)

    def set_state(self, state: ChainState) -> None:
        """Go on from a state of an environment like this one; errors as for `TaskEnv.set_state`."""
        set_state(self, state)

    def resume_episode(self, state: EnvironmentState) -> None:
        """Make `task_env` that of the episode that a state is of, where episodes differ; `set_state` goes on from there.

        Raises:
            InvalidValueError: If the state is of another task or estimator.
        """
        self._task.resume(state)

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles: not a viewer."""
        return vars(self) | {"_viewer": None}

    def close(self) -> None:
        """End the episode, its threads and its recording."""
        self._newest = None
        self._view.close()
        self.task_env.close()
        if self._viewer is not None:
            self._viewer.close()

    def _drawn(self, seed: int | None) -> Values:
        """Draw the episode's configuration; without a seed, from the generator that the last one has set."""
        if self._task.is_random and seed is None:
            seed = int(self.np_random.integers(2**63))
        return self._task.draw(0 if seed is None else int(seed))

    def _begun_task(self, seed: int | None, options: dict[str, Any] | None) -> PhysicsRun[tuple[dict[str, Any], Info]]:
        """Reset the task, on another tissue if need be: training should not break off because of one in a hundred."""
        for _ in range(_TISSUES - 1):
            try:
                return (yield from self.task_env.resetting(seed=seed, options=options))
            except SimulationError:
                # From here on the generator that the seed has set decides.
                seed = None
        return (yield from self.task_env.resetting(seed=seed, options=options))

    def _observation(self, observed: Mapping[str, Any], truth: Mapping[str, Array]) -> Observation:
        return encoded_observation(self.options.observation, self.task_env, self.layout, observed, truth)

    def _privileged(self) -> Mapping[str, Array]:
        return privileged_quantities(self.task_env, self.to_target())

    def _reward_terms(self, before: Info, after: Info, action: Array) -> dict[str, Any]:
        """Return the weighted terms of one control period."""
        if self.options.reward == "sparse":
            return {"success": SUCCESS * float(after["success"])}
        config = self.task_env.config
        fraction = config.loop.control_s / config.max_seconds
        quantities = {
            "force_n": after["contact_force_n"],
            "action": np.nan_to_num(action),
            "succeeded": float(after["success"]),
            "harmed": float(after["terminated_by"] in HARMS),
        }
        shared = shared_terms(quantities, alarm_n=config.alarm_force_n, harm_n=config.harm_force_n, fraction=fraction)
        return {**self.dense_terms(before, after, fraction), **shared}

    def _info(self, info: Info, terms: dict[str, float], truth: Mapping[str, Array]) -> Info:
        return {
            **info,
            "reward_terms": terms,
            "is_success": bool(info["success"]),
            "privileged": PRIVILEGED.encode(truth),
        }

    def _note_time_limit(self) -> None:
        """Say so once if Gymnasium's own limit cuts episodes short of what was asked for."""
        limit = None if self.spec is None else gym.spec(self.spec.id).max_episode_steps
        if limit is not None and self.max_decisions > limit:
            note = f"gymnasium.make ends episodes after {limit} steps; give it max_episode_steps={self.max_decisions} as well"
            warnings.warn(note, LaploopNote, stacklevel=3)


def _worst(infos: Sequence[Info]) -> Info:
    """Return what `info` has of the worst of a control period for several of them."""
    worst: Info = {key: max(info[key] for info in infos) for key in _WORST_SCALARS}
    for key in _WORST_BY_ARM:
        worst[key] = {arm: max(info[key][arm] for info in infos) for arm in infos[0][key]}
    return worst
