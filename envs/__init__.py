"""The theatre: scene composition, ray-cast sensors, clocks and delays, tasks, the Gymnasium face, the recorder.

Importing this package registers its environments, by name alone: nothing heavy is loaded before one is made.
"""

from gymnasium.envs.registration import register

from laploop.envs.tasks.registry import TASKS, environment_id

for _task, _entry_point in TASKS.items():
    register(id=environment_id(_task), entry_point=_entry_point)
