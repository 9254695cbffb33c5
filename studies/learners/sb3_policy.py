"""Policies of stable-baselines3 on disk; its own zip holds pickles, this holds none. Needs the extra `laploop[learning]`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
from pydantic import JsonValue
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.learners.policy_file import load_weights, read_description, save_policy

ALGORITHMS: Mapping[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "tqc": TQC}
"""By the name in a description."""

_KIND = "MlpPolicy"


def save_sb3(model: BaseAlgorithm, folder: Path, policy_kwargs: Mapping[str, JsonValue]) -> None:
    """Write the policy of a model, critics included.

    Args:
        model: One of `ALGORITHMS`, with an `MlpPolicy`.
        folder: Made if it is missing.
        policy_kwargs: What the policy was made with, as `net_arch`.

    Raises:
        InvalidValueError: If the model is of another algorithm.
    """
    name = next((name for name, kind in ALGORITHMS.items() if type(model) is kind), None)
    if name is None:
        raise InvalidValueError("model", type(model).__name__, f"one of {', '.join(ALGORITHMS)}")
    save_policy(model.policy, folder, {"algorithm": name, "policy": _KIND, "policy_kwargs": dict(policy_kwargs)})


def load_sb3(folder: Path, env: gym.Env[Any, Any]) -> BasePolicy:
    """Return a policy that `save_sb3` wrote, for an environment with the same spaces.

    Raises:
        MissingFileError: If there is none.
        UnknownNameError: If its algorithm is not known.
        InvalidValueError: If its description is damaged.
        WeightsError: If the weights are, or do not fit the spaces.
    """
    description = read_description(folder)
    name = str(description.get("algorithm"))
    if name not in ALGORITHMS:
        raise UnknownNameError("algorithm", name, list(ALGORITHMS))
    kind = ALGORITHMS[name].policy_aliases[_KIND]
    try:
        # The rate of learning is that of training, which a policy at work has none of.
        policy: BasePolicy = kind(env.observation_space, env.action_space, lambda _: 0.0, **description["policy_kwargs"])
    except (KeyError, TypeError) as error:
        raise InvalidValueError(
            "description of a policy", description, "one with the policy_kwargs of its algorithm"
        ) from error
    load_weights(policy, folder)
    policy.set_training_mode(False)
    return policy


def load_into(model: BaseAlgorithm, folder: Path) -> None:
    """Go on from a saved policy: its weights, critics included, become the model's; optimisers and replay start anew.

    Raises:
        InvalidValueError: If it is another algorithm's.
        MissingFileError: If there is none.
        WeightsError: If its weights do not fit.
    """
    name = str(read_description(folder).get("algorithm"))
    if ALGORITHMS.get(name) is not type(model):
        raise InvalidValueError("algorithm of the saved policy", name, type(model).__name__.lower())
    load_weights(model.policy, folder)
