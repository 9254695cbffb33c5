"""laploop: depth-in-the-loop laparoscopic control, simulated end to end.

Importing it registers the environments with Gymnasium, by name alone: nothing heavy is loaded before one is made.
"""

from importlib.metadata import version

from gymnasium.envs.registration import register

from laploop.envs.learning.registry import register_learner
from laploop.envs.tasks.registry import TASKS, environment_id

__version__ = version("laploop")
__all__ = ["__version__"]

for _task in TASKS.names():
    register(
        environment_id(_task),
        entry_point="laploop.envs.tasks.registry:make_environment",
        vector_entry_point="laploop.envs.batch.making:make_task_vector",
        kwargs={"task": _task},
    )
    register_learner(_task)
