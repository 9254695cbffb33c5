"""The reference of the configuration tree, from the dataclasses that it is made of."""

from collections.abc import Mapping
from typing import Any

from markdown_table import code, table

from laploop.cli.tree import Leaf, leaves, option_name, toml_value
from laploop.envs import TASKS, EpisodeConfig

_TASK = "task"


def configuration_markdown() -> str:
    """Return a section for each table of the tree: options, defaults, units, bounds, meanings."""
    trees = {name: EpisodeConfig.of(task=name) for name in TASKS.names()}
    found = {name: _tables(tree) for name, tree in trees.items()}
    paths = dict.fromkeys(path for tables in found.values() for path in tables)
    parts = []
    for path in sorted(paths, key=lambda path: (path[:1] == (_TASK,), path)):
        by_task = {name: tables[path] for name, tables in found.items() if path in tables}
        parts.append(_section(path, by_task, every=len(by_task) == len(trees)))
    return "\n\n".join(parts)


def _tables(tree: Any) -> dict[tuple[str, ...], dict[str, Leaf]]:
    """Return the leaves of a tree by the path of their table, and their names."""
    found: dict[tuple[str, ...], dict[str, Leaf]] = {}
    for path, leaf in leaves(tree).items():
        if path != (_TASK, "kind"):
            found.setdefault(path[:-1], {})[path[-1]] = leaf
    return found


def _section(path: tuple[str, ...], by_task: Mapping[str, Mapping[str, Leaf]], *, every: bool) -> str:
    title = f"`[{'.'.join(path)}]`" if path else "The episode"
    parts = [f"## {title}"]
    if not every:
        parts.append(f"Of {_listed(list(by_task))} alone.")
    rows: dict[tuple[str, ...], list[str]] = {}
    for task, table_of_task in by_task.items():
        for leaf in table_of_task.values():
            rows.setdefault(_row(leaf), []).append(task)
    tasks = [len(names) < len(by_task) for names in rows.values()]
    heads = ("option", "default", "unit", "allowed", "meaning", "of the task")
    lines = ((*row, _listed(names) if some else "") for (row, names), some in zip(rows.items(), tasks, strict=True))
    parts.append(table(heads, lines))
    return "\n\n".join(parts)


def _row(leaf: Leaf) -> tuple[str, ...]:
    default = "" if leaf.value is None else code(toml_value(leaf.value))
    return code(option_name(leaf.path, _TASK)), default, leaf.unit, leaf.allowed, leaf.doc


def _listed(names: list[str]) -> str:
    return ", ".join(map(code, names))
