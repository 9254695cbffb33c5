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


def _make_ssle_phase(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.ssle_phase import SslePhaseEstimator

    return SslePhaseEstimator.from_weights(rig, weights)


def _make_ssle(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.ssle import SsleEstimator

    return SsleEstimator.from_weights(rig, weights)


def _make_dual_unet(rig: Rig, weights: Path | None) -> DepthEstimator:
    from laploop.perception.estimators.dual_unet import DualUNetEstimator

    return DualUNetEstimator.from_weights(rig, weights)


def _make_monocular(name: str) -> Factory:
    def make(rig: Rig, weights: Path | None) -> DepthEstimator:
        from laploop.perception.estimators.monocular import MonocularEstimator

        return MonocularEstimator.from_pretrained(rig, name, weights)

    return make


def _refuse_weights(name: str, weights: Path | None) -> None:
    if weights is not None:
        raise InvalidValueError("weights", str(weights), f"none: the estimator {name!r} has nothing to load")


_FACTORIES: dict[str, Factory] = {
    "oracle": _make_oracle,
    "phase": _make_phase,
    "compact": _make_compact,
    "ssle-phase": _make_ssle_phase,
    "ssle": _make_ssle,
    "dual-unet": _make_dual_unet,
}

_BASELINES: dict[str, Factory] = {name: _make_monocular(name) for name in ("dpt", "depth-anything")}
"""For comparison alone: what they say is depth up to a scale, which no loop can close on."""

BASELINE_NAMES: tuple[str, ...] = tuple(_BASELINES)
"""Public networks that laploop measures itself against; their weights are a folder."""

ESTIMATOR_NAMES: tuple[str, ...] = tuple(_FACTORIES)
"""The estimators that laploop brings, ready to run."""


def estimator_names() -> tuple[str, ...]:
    """Return every name that can be made now, the user's own included."""
    return tuple(_FACTORIES)


def register(name: str, factory: Factory) -> None:
    """Add an estimator of the user's own under a new name.

    Raises:
        InvalidValueError: If the name is taken or empty.
    """
    taken = {**_FACTORIES, **_BASELINES}
    if not name or name in taken:
        raise InvalidValueError("name of the estimator", name, f"not empty and none of {', '.join(sorted(taken))}")
    _FACTORIES[name] = factory


def make_estimator(name: str, rig: Rig, weights: Path | None = None) -> DepthEstimator:
    """Make an estimator by name; `weights` replaces the shipped ones where there are any.

    Raises:
        UnknownNameError: If nobody registered the name.
    """
    factories = {**_FACTORIES, **_BASELINES}
    if name not in factories:
        raise UnknownNameError("estimator", name, factories)
    return factories[name](rig, weights)
