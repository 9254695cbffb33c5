"""The estimator that a user chose, by name or as an object."""

import threading
from weakref import WeakValueDictionary

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.registry import make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.network_specs import SHIPPED

_NETWORKS: "WeakValueDictionary[tuple[str, Rig], DepthEstimator]" = WeakValueDictionary()
_MAKING = threading.Lock()


def chosen_estimator(perception: object, rig: Rig) -> DepthEstimator:
    """Return the estimator that a name or an object stands for.

    All loops of a process share one network of a name and a rig: same images give same estimates, whoever asks.

    Args:
        perception: Name of a registered estimator, or an object with `estimate`.
        rig: The rig whose images it will see.

    Raises:
        UnknownNameError: If no estimator has that name.
        InvalidValueError: If the object has no `estimate`.
    """
    if not isinstance(perception, str):
        if isinstance(perception, type) or not isinstance(perception, DepthEstimator):
            raise InvalidValueError("perception", perception, "name of an estimator, or an object with estimate(image)")
        return perception
    if perception not in {spec.name for spec in SHIPPED}:
        return make_estimator(perception, rig)
    with _MAKING:
        shared = _NETWORKS.get((perception, rig)) or make_estimator(perception, rig)
        _NETWORKS[perception, rig] = shared
    return shared
