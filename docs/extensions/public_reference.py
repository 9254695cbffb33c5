"""The reference of the public names: what each subpackage exports."""

import inspect
from importlib import import_module
from typing import Any


def public_markdown(package: str) -> str:
    """Return a section of autodoc directives for the names that a subpackage exports."""
    module = import_module(f"laploop.{package}")
    by_kind: dict[str, list[str]] = {"Classes": [], "Functions": [], "Values": []}
    for name in module.__all__:
        by_kind[_kind_of(getattr(module, name))].append(name)
    parts = []
    for title, names in by_kind.items():
        if names:
            parts += [f"## {title}", "\n\n".join(_directive(package, name, getattr(module, name)) for name in names)]
    return "\n\n".join(parts)


def _kind_of(value: Any) -> str:
    if inspect.isclass(value):
        return "Classes"
    return "Functions" if inspect.isroutine(value) else "Values"


def _directive(package: str, name: str, value: Any) -> str:
    lines = {
        "Classes": (f".. autoclass:: laploop.{package}.{name}", "   :members:", "   :show-inheritance:"),
        "Functions": (f".. autofunction:: laploop.{package}.{name}",),
        "Values": (f".. py:data:: laploop.{package}.{name}", "", f"   {_described(value)}"),
    }[_kind_of(value)]
    return "\n".join([f"### {name}", "", "```{eval-rst}", *lines, "```"])


def _described(value: Any) -> str:
    """Return what a value is; of a registry or a list of entries with names, these."""
    if hasattr(value, "names"):
        return f"Names: {', '.join(f'``{name}``' for name in value.names())}."
    if isinstance(value, tuple):
        return f"Entries: {', '.join(f'``{one.name}``' for one in value)}."
    return f"``{value!r}``"
