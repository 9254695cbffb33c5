"""The reference of the tasks, from their entries and the docstrings of their environments."""

import inspect
import re

from markdown_table import code, table

from laploop.envs import TASKS, environment_id


def tasks_markdown() -> str:
    """Return a line for each task, and a section with what its environment says of itself."""
    rows = []
    for name in TASKS.names():
        spec = TASKS.get(name)
        bars = [f"{one.name} {one.bar()}" for one in spec.criteria if one.bar()]
        longest = f"{spec.config_class().max_seconds:g} s"
        rows.append((f"[{name}](#{name})", code(environment_id(name)), longest, "; ".join(bars)))
    heads = ("task", "id", "longest", "targets over many episodes")
    return "\n\n".join([table(heads, rows), *map(_section, TASKS.names())])


def _section(name: str) -> str:
    environment = TASKS.get(name).environment_class
    # Below the task's own heading.
    text = re.sub(r"^## ", "### ", inspect.cleandoc(environment.__doc__ or ""), flags=re.MULTILINE)
    return f"## {name}\n\n{code(environment_id(name))}, `laploop.envs.{environment.__name__}`.\n\n{text}"
