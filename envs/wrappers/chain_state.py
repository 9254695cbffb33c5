"""The state of an environment with everything that is wrapped around it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import gymnasium as gym
from gymnasium.utils import RecordConstructorArgs

from laploop.envs.environment_state import EnvironmentState, class_place, packed, unpacked
from laploop.envs.tasks.savable_env import SavableEnv
from laploop.envs.tasks.task_env import TaskEnv
from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ChainState:
    """What `get_state` of a wrapped environment returns; see `EnvironmentState`."""

    links: tuple[tuple[str, bytes], ...]
    """Class and memory of each wrapper, Gymnasium's own included, the outermost first."""
    environment: EnvironmentState

    def __repr__(self) -> str:
        kinds = ", ".join(place.rpartition(":")[2] for place, _ in self.links)
        return f"<ChainState of {kinds or 'no wrapper'}, {self.environment!r}>"


class StatefulWrapper(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """A wrapper whose state can be taken and set, together with that of the environment inside."""

    lasting: ClassVar[frozenset[str]] = frozenset()
    """Attributes that belong to no state, besides spaces and the environments inside."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        """Wrap an environment.

        Raises:
            InvalidValueError: If it is the environment of no task.
        """
        super().__init__(env)
        task_of(env)

    @property
    def task_env(self) -> TaskEnv[Any]:
        """The environment of the task inside; where episodes differ in their configuration, another object in each."""
        return task_of(self.env)

    def get_state(self) -> ChainState:
        """Return everything that shapes the future; errors as for `TaskEnv.get_state`."""
        return get_state(self)

    def set_state(self, state: ChainState) -> None:
        """Go on from a state of an environment like this one; errors as for `TaskEnv.set_state`."""
        set_state(self, state)


def get_state(env: gym.Env[Any, Any]) -> ChainState:
    """Return the state of a task's environment with all wrappers around it.

    Raises:
        InvalidValueError: If it is the environment of no task, or what a wrapper remembers cannot be pickled.
    """
    *links, base = _links(env)
    parts = _parts([*links, base])
    return ChainState(
        links=tuple((class_place(type(link)), packed(_memory(link), parts)) for link in links), environment=base.get_state()
    )


def set_state(env: gym.Env[Any, Any], state: ChainState) -> None:
    """Go on from a state of an environment with the same wrappers; a reset before is not needed.

    Where episodes differ in their configuration, the environment takes on that of the state.

    Raises:
        InvalidValueError: If it is no such state, or one of other wrappers, another task, estimator or configuration.
    """
    if not isinstance(state, ChainState):
        raise InvalidValueError("state", type(state).__name__, "what get_state of a wrapped environment has returned")
    *links, base = _links(env)
    memories = _checked_memories(state, links, base)
    for link in links:
        # An environment for learners holds a task of its own for each episode; wrappers only pass the method on.
        if not isinstance(link, gym.Wrapper) and hasattr(link, "resume_episode"):
            link.resume_episode(state.environment)
    *links, present = _links(env)
    if present is not base:
        memories = _checked_memories(state, links, present)
    present.set_state(state.environment)
    for link, memory in zip(links, memories, strict=True):
        vars(link).update(memory)


def task_of(env: gym.Env[Any, Any]) -> TaskEnv[Any]:
    """Return the task's environment inside of others.

    Raises:
        InvalidValueError: If there is none.
    """
    *_, base = _links(env)
    if not isinstance(base, TaskEnv):
        raise InvalidValueError("env", type(base).__name__, "the environment of a laploop task")
    return base


def _checked_memories(state: ChainState, links: list[Any], base: SavableEnv) -> list[dict[str, Any]]:
    """Return copies of what a state's links remember, what is outside of them being found here; errors as for `set_state`."""
    mine, own = [place for place, _ in state.links], [class_place(type(link)) for link in links]
    if mine != own:
        raise InvalidValueError("wrappers of the state", mine, f"{own}, as here")
    parts = _parts([*links, base])
    memories: list[dict[str, Any]] = [unpacked(memory, parts) for _, memory in state.links]
    for link, memory in zip(links, memories, strict=True):
        # Gymnasium keeps with what arguments a wrapper was made.
        made, here = memory.get("_saved_kwargs"), vars(link).get("_saved_kwargs")
        if made != here:
            raise InvalidValueError(f"arguments of {type(link).__name__} in the state", made, f"{here}, as here")
    return memories


def _links(env: gym.Env[Any, Any]) -> Iterator[Any]:
    """Yield an environment and those inside it, down to that of the task."""
    inner: Any = env
    while not isinstance(inner, SavableEnv):
        yield inner
        # What stands around a task without being one of Gymnasium's wrappers has it as `task_env`.
        inner = inner.env if isinstance(inner, gym.Wrapper) else getattr(inner, "task_env", None)
        if inner is None:
            raise InvalidValueError("env", type(env.unwrapped).__name__, "the environment of a laploop task")
    yield inner


def _parts(links: list[Any]) -> dict[str, Any]:
    return {str(depth): link for depth, link in enumerate(links)}


def _memory(link: Any) -> dict[str, Any]:
    """Return what a link would copy and pickle, without what belongs to no state."""
    lasting = {"env", "task_env", "spec", "_cached_spec", "metadata", *getattr(link, "lasting", ())}
    kept: dict[str, Any] = link.__getstate__() or {}
    return {name: value for name, value in kept.items() if name not in lasting and not isinstance(value, gym.Space)}
