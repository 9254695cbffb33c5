"""The reference of the command line, from the parsers of the commands."""

import inspect
from collections.abc import Iterator
from typing import Any, Generic

from markdown_table import code, table

from laploop.cli.main import COMMANDS
from laploop.cli.parsing import Option, arguments_class, options_of
from laploop.cli.tree_options import TreeOptions
from laploop.perception import NETWORKS


def commands_markdown() -> str:
    """Return a section for each command: what it does, and its options."""
    return "\n\n".join(map(_section, sorted(COMMANDS)))


def _section(command: str) -> str:
    kind = arguments_class(command)
    parts = [f"## `laploop {command}`", inspect.cleandoc(kind.__doc__ or "")]
    for title, options in _options(kind):
        parts += [title] if title else []
        parts += [_table(options)] if options else ["It takes no options."]
    if _takes_a_tree(kind):
        parts.append("It also takes every field of the [configuration](configuration.md) as an option.")
    return "\n\n".join(parts)


def _options(kind: Any) -> Iterator[tuple[str, list[Option]]]:
    """Yield the options of a command; of one that trains networks, those that a network adds in a table of their own."""
    if not issubclass(kind, Generic):
        yield "", options_of(kind)
        return
    by_network = {
        name: options_of(kind[spec.options]) for name in NETWORKS.names() if (spec := NETWORKS.get(name)).options is not None
    }
    first = next(iter(by_network.values()))
    shared = [one for one in first if all(one in options for options in by_network.values())]
    yield "", shared
    for name, options in by_network.items():
        yield f"With `--model {name}` also:", [one for one in options if one not in shared]


def _takes_a_tree(kind: type) -> bool:
    return any("TreeOptions" in str(one) or one is TreeOptions for one in kind.__annotations__.values())


def _table(options: list[Option]) -> str:
    rows = sorted(options, key=lambda option: (not option.required, option.names))
    return table(
        ("option", "value", "default", "meaning"),
        (
            (
                " ".join(map(code, option.names)) or "*first word*",
                code(option.values.strip("{}").replace(",", ", ") if "{" in option.values else option.values),
                "**required**" if option.required else code(option.default),
                option.meaning,
            )
            for option in rows
        ),
    )
