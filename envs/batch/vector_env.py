"""Many theatres behind Gymnasium's vector interface."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, cast

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array
from numpy.typing import NDArray

from laploop.envs.batch.group import EnvironmentGroup, Face, Result, named
from laploop.envs.batch.group_process import AskedGroup, GroupProcess, LocalGroup
from laploop.envs.batch.stepper import MOST_THREADS, checked_count
from laploop.envs.tasks.reset_arguments import check_reset
from laploop.envs.tasks.steppable_env import Info, SteppableEnv
from laploop.errors import InvalidValueError, SimulationError
from laploop.workers import usable_cores

MOST_ENVIRONMENTS = 4096
MOST_WORKERS = 256

StepBatch = tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]


class TheatreVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """N environments that advance together, each with the bits that it has alone.

    They are shared out among worker processes, one a core by default; in each, physics is computed for all of its environments
    at once. `docs/vector.md` says what to choose when.

    An environment that fails in a step does not keep the others from theirs: the error is raised when all are done, and names
    the environment; reset it by `reset(options={"reset_mask": mask})`. What can be refused is refused before anything moves.

    What is None in the `info` of an environment is left out of `infos`, where its mask is False.
    """

    def __init__(
        self,
        makers: Sequence[Callable[[], SteppableEnv]],
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        workers: int | None = None,
        threads: int = 1,
    ) -> None:
        """Make the environments.

        Args:
            makers: What makes each; picklable with more than one worker.
            autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED, or Gymnasium's names of them.
            max_episode_steps: Steps after which episodes are truncated; None for the tasks' own limits alone.
            workers: Processes; by default one for each core that may be used, up to one an environment. 1 is this process.
            threads: Threads of the physics in each of them.

        Raises:
            InvalidValueError: If a number is not allowed, or there is no such mode.
            WorkerError: If a process cannot be started.
        """
        self.num_envs = checked_count("num_envs", len(makers), MOST_ENVIRONMENTS)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        if max_episode_steps is not None:
            checked_count("max_episode_steps", max_episode_steps, 2**31)
        checked_count("threads", threads, MOST_THREADS)
        limit = min(self.num_envs, usable_cores()) if workers is None else checked_count("workers", workers, MOST_WORKERS)
        self.workers = min(limit, self.num_envs)
        shares = np.array_split(np.arange(self.num_envs), self.workers)
        self._shares = [share.tolist() for share in shares]
        group = partial(
            EnvironmentGroup,
            autoreset=self.autoreset_mode,
            max_steps=max_episode_steps,
            threads=threads,
            alone=self.num_envs == 1,
        )
        self._groups: list[AskedGroup] = []
        try:
            for number, share in enumerate(self._shares):
                make = partial(group, {each: makers[each] for each in share})
                self._groups.append(LocalGroup(make) if self.workers == 1 else GroupProcess(number, make))
            faces: dict[int, Face] = {}
            for asked in self._groups:
                faces |= asked.answer()[0]
            _check_spaces(faces)
        except BaseException:
            self.close()
            raise
        face = faces[0]
        self._reset_options = face.reset_options
        self._action_checks = [faces[number].action_check for number in range(self.num_envs)]
        self.metadata = {**face.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = face.render_mode
        self.single_observation_space, self.single_action_space = face.observation_space, face.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._observations: list[Any] = [None] * self.num_envs
        self._resetting: set[int] = set()

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Begin episodes.

        Args:
            seed: One for each environment, or one from which they count up.
            options: As those of the environments; also `reset_mask`, (N,) booleans: which environments are reset. The
                observations of the others are their last ones.

        Raises:
            UnknownNameError: If there is no such option.
            InvalidValueError: If seeds, mask or an option are not allowed, or environments that never began are left out.
        """
        given = dict(options or {})
        chosen = self._chosen(given.pop("reset_mask", None))
        seeds = self._seeds(seed)
        for number in chosen:
            with named(number):
                check_reset(seeds[number], given, self._reset_options)
        infos: Info = {}
        for number, (observation, info) in self._all(
            "reset", [({each: seeds[each] for each in share if each in chosen}, given) for share in self._shares]
        ):
            self._observations[number] = observation
            self._resetting.discard(number)
            infos = self._add_info(infos, info, number)
        return self._batched(), infos

    def step(self, actions: Any) -> StepBatch:
        """Step all environments.

        Raises:
            InvalidValueError: If there is not an action an environment, or one is refused; nothing has moved then.
            SimulationError: If an episode has ended or not begun, or an environment fails.
            WorkerError: If a worker process died.
        """
        if any(observation is None for observation in self._observations):
            raise SimulationError("the episodes have not begun; call reset() first")
        chosen = self._actions(actions)
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros(self.num_envs, dtype=np.bool_), np.zeros(self.num_envs, dtype=np.bool_)
        infos: Info = {}
        result: Result
        for number, result in self._all("step", [({each: chosen[each] for each in share},) for share in self._shares]):
            self._observations[number] = result.observation
            rewards[number], terminated[number], truncated[number] = result.reward, result.terminated, result.truncated
            if result.final is not None:
                final = dict(zip(("final_obs", "final_info"), result.final, strict=True))
                infos = self._add_info(infos, final, number)
            infos = self._add_info(infos, result.info, number)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            self._resetting = set(np.flatnonzero(terminated | truncated).tolist())
        return self._batched(), rewards, terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """Return the picture of each environment."""
        return self.call("render")

    def call(self, name: str, *arguments: Any, **keywords: Any) -> tuple[Any, ...]:
        """Return an attribute of each environment, called with arguments if it can be; workers send back copies."""
        return tuple(result for _, result in self._all("call", [(name, arguments, keywords)] * len(self._groups)))

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment; workers send back copies."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each environment: to its own of N values in a list or tuple, or to the same.

        Raises:
            InvalidValueError: If there is not a value an environment.
        """
        each = list(values) if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise InvalidValueError("number of values", len(each), f"{self.num_envs}, one an environment")
        self._all("set_attribute", [(name, {one: each[one] for one in share}) for share in self._shares])

    def close_extras(self, **_unused: Any) -> None:
        """End all environments and processes."""
        for group in self._groups:
            group.begin_close()
        for group in self._groups:
            group.close()
        self._groups = []

    def __del__(self) -> None:
        if not self.closed and getattr(self, "_groups", None):
            self.close()

    def _all(self, name: str, arguments: Sequence[tuple[Any, ...]]) -> list[tuple[int, Any]]:
        """Call a method of every group at once; return the environments' results, by their numbers, in order.

        The error of the environment with the lowest number is raised, if any failed.
        """
        if not self._groups:
            raise SimulationError("the environments are closed")
        try:
            for group, each in zip(self._groups, arguments, strict=True):
                group.ask(name, *each)
            answers = [group.answer() for group in self._groups]
        except BaseException:
            # Answers that nobody has read would be taken for those of the next question.
            self.close()
            raise
        errors = {number: error for _, failed in answers for number, error in failed.items()}
        if errors:
            number = min(errors)
            with named(number):
                raise errors[number]
        return sorted((number, result) for results, _ in answers for number, result in results.items())

    def _batched(self) -> Any:
        """Return the newest observations, stacked along a leading dimension, the caller's own."""
        out = create_empty_array(self.single_observation_space, n=self.num_envs, fn=np.zeros)
        return concatenate(self.single_observation_space, self._observations, cast("Any", out))

    def _add_info(self, vector_infos: Info, env_info: Info, env_num: int) -> Info:
        known = {key: value for key, value in env_info.items() if value is not None}
        added: Info = super()._add_info(vector_infos, known, env_num)
        return added

    def _actions(self, actions: Any) -> list[Any]:
        """Return the action of each environment, checked unless it begins an episode instead of taking one."""
        chosen = list(actions) if isinstance(actions, Iterable) else []
        if len(chosen) != self.num_envs:
            raise InvalidValueError("number of actions", len(chosen), f"{self.num_envs}, one an environment")
        for number, action in enumerate(chosen):
            if number not in self._resetting:
                with named(number):
                    self._action_checks[number](action)
        return chosen

    def _seeds(self, seed: Any) -> list[int | None]:
        """Return the seed of each environment."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            if len(seed) != self.num_envs:
                raise InvalidValueError("number of seeds", len(seed), f"{self.num_envs}, one an environment")
            return list(seed)
        check_reset(seed, None, ())
        return [int(seed) + number for number in range(self.num_envs)]

    def _chosen(self, mask: Any) -> list[int]:
        """Return the environments that a mask chooses."""
        if mask is None:
            return list(range(self.num_envs))
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise InvalidValueError("reset_mask", mask, f"an array of {self.num_envs} booleans, at least one of them True")
        left_out = [number for number in np.flatnonzero(~mask).tolist() if self._observations[number] is None]
        if left_out:
            raise InvalidValueError("reset_mask", mask, f"True for environment {left_out[0]}, which has never begun")
        return [int(number) for number in np.flatnonzero(mask)]


def _check_spaces(faces: Mapping[int, Face]) -> None:
    """Raise an InvalidValueError unless all environments have the same spaces, so that they stack."""
    first = faces[0]
    for number, face in sorted(faces.items()):
        for name in ("observation_space", "action_space"):
            if getattr(face, name) != getattr(first, name):
                with named(number):
                    raise InvalidValueError(name, getattr(face, name), f"that of environment 0, {getattr(first, name)}")


def _autoreset_mode(mode: str | AutoresetMode) -> AutoresetMode:
    """Return a mode by Gymnasium's name of it, or that of the constant."""
    if isinstance(mode, AutoresetMode):
        return mode
    by_name = {one.name: one for one in AutoresetMode} | {one.value: one for one in AutoresetMode}
    if mode not in by_name:
        raise InvalidValueError("autoreset_mode", mode, ", ".join(one.name for one in AutoresetMode))
    return by_name[mode]
