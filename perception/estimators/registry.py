"""Estimators by name.

A factory imports what it needs when it is called, so that asking for `phase` never loads torch.
"""

from collections.abc import Callable
from pathlib import Path

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.geometry import Rig

Factory = Callable[[Rig, Path | None], DepthEstimator]


def _make_oracle(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.oracle import OracleEstimator

    _refuse_weights("oracle", weights)
    return OracleEstimator(rig)


def _make_phase(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.phase import PhaseEstimator

    _refuse_weights("phase", weights)
    return PhaseEstimator(rig=rig)


def _make_compact(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.compact import CompactEstimator

    return CompactEstimator.from_weights(rig, weights)


def _refuse_weights(name: str, weights: Path | None) -> None:
    if weights is not None:
        raise InvalidValueError("weights", str(weights), f"none: the estimator {name!r} has nothing to load")


_FACTORIES: dict[str, Factory] = {"oracle": _make_oracle, "phase": _make_phase, "compact": _make_compact}

ESTIMATOR_NAMES: tuple[str, ...] = tuple(_FACTORIES)
"""The estimators that laploop brings."""


def estimator_names() -> tuple[str, ...]:
    """Return every name that can be made now, the user's own included."""
    return tuple(_FACTORIES)


def register(name: str, factory: Factory) -> None:
    """Add an estimator of the user's own under a new name.

    Raises:
        InvalidValueError: If the name is taken or empty.
    """
    if not name or name in _FACTORIES:
        raise InvalidValueError("name of the estimator", name, f"not empty and none of {', '.join(sorted(_FACTORIES))}")
    _FACTORIES[name] = factory


def make_estimator(name: str, rig: Rig, weights: Path | None = None) -> DepthEstimator:
    """Make an estimator by name; `weights` replaces the shipped ones where there are any.

    Raises:
        UnknownNameError: If nobody registered the name.
    """
    if name not in _FACTORIES:
        raise UnknownNameError("estimator", name, _FACTORIES)
    return _FACTORIES[name](rig, weights)
