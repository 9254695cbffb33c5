"""Environments that advance together in one process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from laploop.arrays import Array
from laploop.envs.batch.lock_step import run_in_lock_step
from laploop.envs.batch.stepper import Stepper, ThreadedStepper
from laploop.envs.tasks.steppable_env import Begin, Info, SteppableEnv
from laploop.envs.theatre.physics_call import PhysicsRun
from laploop.errors import LaploopError


class Face(NamedTuple):
    """What an environment looks like from outside."""

    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]
    metadata: dict[str, Any]
    render_mode: str | None
    reset_options: tuple[str, ...]
    action_check: Callable[[object], Array]

    @classmethod
    def of(cls, env: SteppableEnv) -> "Face":
        """Take it from an environment."""
        return cls(*(getattr(env, name) for name in cls._fields))


class Result(NamedTuple):
    """What a step of one environment gave."""

    observation: Any
    reward: float
    terminated: bool
    truncated: bool
    info: Info
    final: Begin | None
    """Last observation and info of an episode, where the next one has begun in the same step."""


@contextmanager
def named(number: int) -> Iterator[None]:
    """Put the environment's number in front of the errors raised within."""
    try:
        yield
    except LaploopError as error:
        raise error.at(f"environment {number}", ": ") from error
    except Exception as error:
        error.add_note(f"in environment {number}")
        raise


Outcome = tuple[dict[int, Any], dict[int, Exception]]
"""By the environment's number: results, and the errors of those that failed."""


class EnvironmentGroup:
    """Some of the environments of a vector, numbered as in it; all calls name environments by these numbers."""

    def __init__(
        self,
        makers: Mapping[int, Callable[[], SteppableEnv]],
        *,
        autoreset: AutoresetMode,
        max_steps: int | None = None,
        threads: int = 1,
        alone: bool = False,
    ) -> None:
        """Make the environments.

        Args:
            makers: What makes each.
            autoreset: When an episode that has ended is followed by the next.
            max_steps: Steps after which an episode is truncated, as `gymnasium.wrappers.TimeLimit` does; None for no limit.
            threads: Of the physics.
            alone: Whether there is no other environment, for which cores should be left.
        """
        self._stepper: Stepper = ThreadedStepper(threads)
        self._envs: dict[int, SteppableEnv] = {}
        for number, make in makers.items():
            with named(number):
                env = self._envs[number] = make()
            if not alone:
                env.share_cores()
        self._autoreset = autoreset
        self._max_steps = max_steps
        self._steps = dict.fromkeys(self._envs, 0)
        self._ended: set[int] = set()

    def faces(self) -> Outcome:
        """Return the `Face` of each environment."""
        return {number: Face.of(env) for number, env in self._envs.items()}, {}

    def reset(self, seeds: Mapping[int, int | None], options: dict[str, Any] | None) -> Outcome:
        """Begin episodes; each result is a `Begin`.

        Args:
            seeds: Of those environments that are to be reset.
            options: As those of the environments.
        """
        return self._begin({number: self._envs[number].resetting(seed=seed, options=options) for number, seed in seeds.items()})

    def step(self, actions: Mapping[int, Any]) -> Outcome:
        """Step all environments; each result is a `Result`.

        In the mode NEXT_STEP, an environment whose episode ended in the step before begins the next one instead.
        """
        runs: dict[int, PhysicsRun[Any]] = {}
        begun = self._ended if self._autoreset is AutoresetMode.NEXT_STEP else set()
        for number, env in self._envs.items():
            runs[number] = env.resetting() if number in begun else env.stepping(actions[number])
        results, errors = run_in_lock_step(runs, self._stepper)
        outcome: dict[int, Any] = {}
        for number, result in results.items():
            self._steps[number] = 0 if number in begun else self._steps[number] + 1
            outcome[number] = self._begun(*result) if number in begun else self._stepped(number, *result)
        self._ended = {number for number, result in outcome.items() if result.terminated or result.truncated}
        if self._autoreset is AutoresetMode.SAME_STEP:
            self._follow_up(outcome, errors)
        return outcome, errors

    def call(self, name: str, arguments: Sequence[Any], keywords: Mapping[str, Any]) -> Outcome:
        """Return an attribute of every environment, called with arguments if it can be."""
        results: dict[int, Any] = {}
        errors: dict[int, Exception] = {}
        for number, env in self._envs.items():
            try:
                found = getattr(env, name)
                results[number] = found(*arguments, **keywords) if callable(found) else found
            except Exception as error:  # noqa: BLE001 - raised by the vector, with the environment's number
                errors[number] = error
        return results, errors

    def set_attribute(self, name: str, values: Mapping[int, Any]) -> Outcome:
        """Set an attribute of every environment."""
        for number, value in values.items():
            setattr(self._envs[number], name, value)
        return {}, {}

    def close(self) -> Outcome:
        """End all environments and threads."""
        for env in self._envs.values():
            env.close()
        self._stepper.close()
        return {}, {}

    def _begin(self, runs: Mapping[int, PhysicsRun[Begin]]) -> Outcome:
        """Run resets."""
        begun, errors = run_in_lock_step(runs, self._stepper)
        for number in runs:
            self._steps[number] = 0
            self._ended.discard(number)
        return dict(begun), errors

    def _begun(self, observation: Any, info: Info) -> Result:
        return Result(observation, 0.0, terminated=False, truncated=False, info=info, final=None)

    def _stepped(self, number: int, observation: Any, reward: float, terminated: bool, truncated: bool, info: Info) -> Result:  # noqa: FBT001
        late = self._max_steps is not None and self._steps[number] >= self._max_steps
        return Result(observation, reward, terminated, truncated or late, info, None)

    def _follow_up(self, outcome: dict[int, Any], errors: dict[int, Exception]) -> None:
        """Begin the next episode of those environments whose last one has just ended, in place."""
        begun, failed = self._begin({number: self._envs[number].resetting() for number in sorted(self._ended)})
        for number, (observation, info) in begun.items():
            last: Result = outcome[number]
            outcome[number] = last._replace(observation=observation, info=info, final=(last.observation, last.info))
        errors |= failed
