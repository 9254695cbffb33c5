"""Estimators by name. Each is imported when it is made, so that asking for `phase` never loads torch."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig
from laploop.perception.network_specs import SHIPPED, NetworkSpec
from laploop.registry import Registry, call_checked

Factory = Callable[..., DepthEstimator]
"""A class, for example: called with the rig, with `weights` if a file is given, and with the user's arguments by name."""

_ROOM = "laploop.perception.estimators"

ESTIMATORS: Registry[Factory | NetworkSpec] = Registry(
    "estimator",
    "laploop.estimators",
    {
        "oracle": f"{_ROOM}.oracle:OracleEstimator",
        "phase": f"{_ROOM}.phase:PhaseEstimator",
        **{spec.name: spec for spec in SHIPPED},
    },
)
"""What a loop can close on."""

BASELINES: Registry[Factory] = Registry(
    "baseline", "laploop.baselines", {"dpt": f"{_ROOM}.monocular:dpt", "depth-anything": f"{_ROOM}.monocular:depth_anything"}
)
"""For comparison alone: their depth is known up to a scale, which no loop can close on. Their weights are a folder."""


def check_estimator(name: str) -> None:
    """Raise an `UnknownNameError` unless `make_estimator` knows the name, or it is a `module:Class`; imports nothing."""
    if name not in BASELINES.names():
        ESTIMATORS.check(name)


def make_estimator(
    name: str, rig: Rig, weights: Path | None = None, arguments: Mapping[str, Any] | None = None
) -> DepthEstimator:
    """Make an estimator.

    Args:
        name: A registered name, or `module:Class` of a class that is called with the rig.
        rig: The rig whose images it will see.
        weights: Replaces the shipped weights where there are any.
        arguments: Further arguments by name.

    Raises:
        UnknownNameError: If nobody registered the name.
        InvalidValueError: If it cannot be imported, does not take the arguments, or makes no estimator.
        MissingFileError: If the weights are not there.
        WeightsError: If they are damaged, of another network, or not safetensors.
    """
    check_estimator(name)
    entry = BASELINES.get(name) if name in BASELINES.names() else ESTIMATORS.get(name)
    given = dict(arguments or {})
    if isinstance(entry, NetworkSpec):
        from laploop.perception.inference.models import load_network

        factory: Factory = partial(entry.imported(entry.estimator), network=load_network(entry, rig, weights))
    else:
        factory = entry
        given |= {} if weights is None else {"weights": Path(weights)}
    made = call_checked("estimator", name, factory, rig, **given)
    if not isinstance(made, DepthEstimator):
        raise InvalidValueError(
            "estimator", name, f"what makes an object with estimate(image); it made a {type(made).__name__}"
        )
    return made
