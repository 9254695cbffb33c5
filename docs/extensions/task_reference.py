"""The tasks in a table, from their entries."""

from markdown_table import code, table

from laploop.envs import TASKS, environment_id


def tasks_markdown() -> str:
    """Return a line for each task: its id, its classes, how long it lasts, and what counts over many episodes."""
    rows = []
    for name in TASKS.names():
        spec = TASKS.get(name)
        summary = (spec.environment_class.__doc__ or "").strip().splitlines()[0]
        bars = [f"{one.name} {one.bar()}".strip() for one in spec.criteria if one.bar()]
        rows.append(
            (
                f"[{name}]({name}.md)",
                code(environment_id(name)),
                summary,
                f"{spec.config_class().max_seconds:g} s",
                "; ".join(bars),
            )
        )
    return table(("task", "id", "what to do", "longest", "targets over many episodes"), rows)
