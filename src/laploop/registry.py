"""One table for each kind of thing that has a name: what laploop brings, what other packages add, what a user points at."""

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from pkgutil import resolve_name
from typing import Any, Generic, TypeVar, cast

from laploop.errors import InvalidValueError, UnknownNameError

T = TypeVar("T")


class Registry(Generic[T]):
    """Objects by name, each imported only when it is asked for.

    Three sources, in this order: the built-in table; what was registered by `register`; the entry points that installed
    packages declare in the registry's group. `module:attribute` is accepted wherever a name is.
    """

    def __init__(self, kind: str, group: str, built_in: Mapping[str, T | str]) -> None:
        """Make the table.

        Args:
            kind: What its entries are called in messages, such as `estimator`.
            group: The group of entry points, such as `laploop.estimators`.
            built_in: Entries by name: objects, or `module:attribute` to be imported when needed.
        """
        self.kind = kind
        self.group = group
        self._entries: dict[str, T | str] = dict(built_in)

    def names(self) -> tuple[str, ...]:
        """Return the names of all entries, the built-in ones first, in their order; imports none of them."""
        return tuple(dict.fromkeys([*self._entries, *self._installed()]))

    def register(self, name: str, entry: T) -> None:
        """Add an entry.

        Raises:
            InvalidValueError: If the name is taken, empty, or holds a colon.
        """
        if not name or ":" in name or name in self._entries:
            raise InvalidValueError(f"name of the {self.kind}", name, f"no colon; not one of {', '.join(self.names())}")
        self._entries[name] = entry

    def unregister(self, name: str) -> None:
        """Remove an entry that `register` added."""
        self._entries.pop(name, None)

    def check(self, name: str) -> None:
        """Raise an UnknownNameError unless the name is known, or has the form `module:attribute`; imports nothing."""
        if not _is_path(name) and name not in self._entries and name not in self._installed():
            raise UnknownNameError(self.kind, name, self.names())

    def get(self, name: str) -> T:
        """Return the entry of a name, or the object that `module:attribute` points at.

        Raises:
            UnknownNameError: If nothing has that name.
            InvalidValueError: If what it points at cannot be imported.
        """
        self.check(name)
        entry = self._entries.get(name)
        if entry is None and not _is_path(name):
            return self._imported(name, self._installed()[name].value)
        if isinstance(entry, str) or entry is None:
            return self._imported(name, entry or name)
        return entry

    def make(self, name: str, /, *given: Any, **arguments: Any) -> Any:
        """Call the entry of a name.

        Args:
            name: A registered name, or `module:attribute`.
            given: What every entry of this registry is called with.
            arguments: The user's own, by name.

        Raises:
            UnknownNameError: If nothing has that name.
            InvalidValueError: If what it points at cannot be imported, cannot be called, or does not take the arguments.
        """
        return call_checked(self.kind, name, self.get(name), *given, **arguments)

    def _installed(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)}

    def _imported(self, name: str, path: str) -> T:
        try:
            return cast("T", resolve_name(path))
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            raise InvalidValueError(self.kind, name, f"what can be imported ({path} raised {reason})") from error


def _is_path(name: str) -> bool:
    module, colon, attribute = name.partition(":")
    return bool(colon) and all(part.isidentifier() for part in (*module.split("."), *attribute.split(".")))


def call_checked(kind: str, name: str, entry: Any, /, *given: Any, **arguments: Any) -> Any:
    """Call what a name stands for, after a check that it takes the arguments.

    Raises:
        InvalidValueError: If it cannot be called, or does not take the arguments; what it raises itself passes.
    """
    if not callable(entry):
        raise InvalidValueError(kind, name, f"a class or a function; it is of type {type(entry).__name__}")
    try:
        taken = signature(entry)
        taken.bind(*given, **arguments)
    except ValueError:
        pass  # Some callables written in C have no signature to check against.
    except TypeError as error:
        allowed = f"those of {name}{taken} ({error})"
        raise InvalidValueError(f"names of arguments of {kind} {name}", list(arguments), allowed) from None
    return entry(*given, **arguments)
