"""Demonstrations of random numbers, and data sets of them."""

from importlib.metadata import version
from types import SimpleNamespace

import numpy as np
from gymnasium import spaces

from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.demonstration import Demonstration

IMAGE = spaces.Box(0, 255, (48, 40, 1), np.uint8)
VECTOR = spaces.Box(-5.0, 5.0, (6,), np.float32)
SPACES = {
    "state": VECTOR,
    "depth": spaces.Dict({"depth": IMAGE, "proprioception": VECTOR}),
    "stripes": spaces.Dict({"stripes": IMAGE, "proprioception": VECTOR}),
    "depth+state": spaces.Dict({"depth": IMAGE, "state": VECTOR}),
}


def made_up(seed, *, success=True, observation="state", decisions=None, space=None):
    """An episode of random numbers, observed in one of `SPACES` or in a space of its own."""
    rng = np.random.default_rng(seed)
    count = decisions or 3 + seed % 3

    def drawn(part):
        if part.dtype == np.uint8:
            return rng.integers(0, 256, (count + 1, *part.shape), dtype=np.uint8)
        return rng.normal(size=(count + 1, *part.shape)).astype(np.float32)

    space = space or SPACES[observation]
    parts = space.spaces if isinstance(space, spaces.Dict) else {"state": space}
    ends = np.arange(count) == count - 1
    return Demonstration(
        observations={key: drawn(part) for key, part in parts.items()},
        actions=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        expert_actions=rng.uniform(-1, 1, (count + 1, 3)).astype(np.float32),
        rewards=rng.normal(size=count),
        terminations=ends & success,
        truncations=ends & (not success),
        successes=np.append(False, ends & success),
        privileged=rng.normal(size=(count + 1, 13)).astype(np.float32),
        outcome={
            "seed": seed,
            "success": success,
            "terminated_by": "success" if success else "time",
            "decisions": count,
            "return": 1.5,
            "randomisation": {"loop.theatre.tissue.material.young_pa": 1000.0 + seed},
            "noise": 0.05,
            "pushes": [{"begin_s": 0.1, "action": [0.1, 0.2, -0.3]}],
        },
    )


def card_of(observation="state", **changes):
    """The card of such episodes."""
    keywords = {} if observation == "state" else {"observation": observation}
    given = {
        "laploop": version("laploop"),
        "task": "reach",
        "environment": "laploop/Reach-v1",
        "keywords": keywords,
        "instruction": "Touch the point.",
        "decision_period_ms": 40.0,
        "action_scale": 0.06,
        "entries": {"tip_position": [0, 3], "target_pixel": [3, 5], "target_distance": [5, 6]},
        "depth_range_mm": (40.0, 160.0),
        "expert": {"controller": "reach"},
        "keep": "all",
    }
    return Card(**{**given, **changes})


def spaces_for(observation):
    """What a writer asks of an environment."""
    return SimpleNamespace(
        observation_space=SPACES[observation], action_space=spaces.Box(-1.0, 1.0, (3,), np.float32), spec=None
    )
