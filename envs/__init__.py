"""The theatre: scene composition, ray-cast sensors, clocks and delays, tasks, the Gymnasium face, the recorder.

Importing this package registers its environments, by name alone: nothing heavy is loaded before one is made.
"""

from gymnasium.envs.registration import register

register(id="laploop/Reach-v0", entry_point="laploop.envs.reach_env:ReachEnv")
