"""laploop: depth-in-the-loop laparoscopic control, simulated end to end.

Importing it registers the environments with Gymnasium, by name alone: nothing heavy is loaded before one is made.
"""

from importlib.metadata import version

from gymnasium.envs.registration import register

from laploop.envs.tasks.registry import TASKS, environment_id

__version__ = version("laploop")
__all__ = ["__version__"]

for _task, _entry_point in TASKS.items():
    register(id=environment_id(_task), entry_point=_entry_point)
