"""The same acquisition as tasks of a Ray cluster; needs the extra `laploop[ray]`."""

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from laploop.errors import MissingFileError, WorkerError
from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.station import collect_tissue

_POLL_S = 0.5
_CONNECT_S = 5.0
_LOCAL = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""With 0, a cluster may not extend to other machines, and binds 127.0.0.1; otherwise its head listens on all interfaces."""
_ENVIRONMENT = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray would warn that it leaves the variables for accelerators alone from some version on; there are none here.
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    _LOCAL: "0",
}
"""Read when Ray is imported."""


@contextmanager
def ray_cluster(workers: int) -> Iterator[None]:
    """Connect to the cluster that `RAY_ADDRESS` names, or start one on this machine, which stops at the block's end.

    A cluster that is started here can be reached from this machine alone. No statistics of use are sent. A connection that the
    caller made before is used and kept.

    Args:
        workers: Number of processes of a cluster that is started here.

    Raises:
        MissingFileError: If Ray is not installed.
        WorkerError: If the cluster cannot be reached or started.
    """
    if find_spec("ray") is None:
        raise MissingFileError("Ray", "this Python", "install the extra: pip install 'laploop[ray]'")
    if "ray" not in sys.modules:
        for name, value in _ENVIRONMENT.items():
            os.environ.setdefault(name, value)
    import ray

    if ray.is_initialized():
        yield
        return
    if _LOCAL not in os.environ:
        raise WorkerError(f"Ray was imported before it could be bound to 127.0.0.1; set {_LOCAL}=0, or call ray.init first")
    try:
        _connect(ray, workers)
        yield
    finally:
        ray.shutdown()


def collect_with_ray(config: AcquisitionConfig, out: Path, tissues: Sequence[int], written: Callable[[], None]) -> None:
    """Collect the missing pairs of some tissues, a task each, inside `ray_cluster`.

    The cluster's machines must all see the store at the same path.
    """
    import ray

    task = ray.remote(collect_tissue)
    waiting = [task.options(max_retries=2).remote(config, out.resolve(), tissue) for tissue in tissues]
    while waiting:
        finished, waiting = ray.wait(waiting, num_returns=len(waiting), timeout=_POLL_S)
        for result in finished:
            try:
                ray.get(result)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
        written()


def _connect(ray: Any, workers: int) -> None:
    cluster = os.environ.get("RAY_ADDRESS")
    options: dict[str, Any] = {"address": cluster} if cluster else {"num_cpus": workers, "include_dashboard": False}
    try:
        host, _, port = (cluster or "").removeprefix("ray://").rpartition(":")
        if host and port.isdigit():
            # Ray itself would try for minutes.
            socket.create_connection((host, int(port)), timeout=_CONNECT_S).close()
        ray.init(logging_level=logging.ERROR, log_to_driver=False, configure_logging=False, **options)
    # Ray raises anything from a TimeoutError to exceptions of its own.
    except Exception as error:
        what = f"reach the Ray cluster at {cluster}" if cluster else "start a Ray cluster"
        reason = str(error).strip().partition("\n")[0] or type(error).__name__
        raise WorkerError(f"cannot {what}: {reason}") from error
