"""The estimator that a user chose, by name or as an object."""

import threading
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import check_estimator, make_estimator
from laploop.perception.geometry import Rig

if TYPE_CHECKING:
    from laploop.perception.messages import DepthEstimate


class DeferredEstimator:
    """An estimator that is made when it gets its first image, for loops whose depth may never be asked for."""

    def __init__(self, name: str, rig: Rig) -> None:
        """Keep the name of an estimator.

        Raises:
            UnknownNameError: If nobody registered it.
        """
        check_estimator(name)
        self._name = name
        self._rig = rig
        self._made: DepthEstimator | None = None
        self._lock = threading.Lock()

    def estimate(self, image: NDArray[np.uint8]) -> "DepthEstimate":
        """Return what the estimator makes of an image; errors as for `make_estimator` and its `estimate`."""
        with self._lock:
            self._made = self._made or make_estimator(self._name, self._rig)
        return self._made.estimate(image)


def chosen_estimator(perception: object, rig: Rig, *, at_once: bool = True) -> DepthEstimator:
    """Return the estimator that a name or an object stands for.

    Args:
        perception: Name of a registered estimator, or an object with `estimate`.
        rig: The rig whose images it will see.
        at_once: Whether to make it now; otherwise a network is loaded when it gets its first image.

    Raises:
        UnknownNameError: If no estimator has that name.
        InvalidValueError: If the object has no `estimate`.
    """
    if isinstance(perception, str):
        # The oracle costs nothing, and the loop knows it by its class.
        deferred = not at_once and perception != "oracle"
        return DeferredEstimator(perception, rig) if deferred else make_estimator(perception, rig)
    if isinstance(perception, type) or not isinstance(perception, DepthEstimator):
        raise InvalidValueError("perception", perception, "name of an estimator, or an object with estimate(image)")
    return perception
