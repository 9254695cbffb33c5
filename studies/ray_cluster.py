"""A Ray cluster for as long as a block lasts; needs the extra `laploop[ray]`."""

import logging
import os
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from laploop.errors import MissingFileError, WorkerError

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
def ray_cluster(workers: int, address: str | None = None) -> Iterator[None]:
    """Connect to a cluster, or start one on this machine, which stops at the end of the block.

    A cluster that is started here can be reached from this machine alone. No statistics of use are sent. A connection that the
    caller made before is used and kept.

    Args:
        workers: Number of processes of a cluster that is started here.
        address: Of a running cluster, host:port or ray://host:port; by default what `RAY_ADDRESS` names, if anything.

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
        _connect(ray, workers, address)
        yield
    finally:
        ray.shutdown()


def _connect(ray: Any, workers: int, address: str | None) -> None:
    cluster = address or os.environ.get("RAY_ADDRESS")
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
