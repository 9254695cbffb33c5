"""The same acquisition as tasks of a Ray cluster; needs the extra `laploop[ray]`."""

import logging
import os
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from laploop.errors import MissingFileError, WorkerError
from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.station import collect_tissue

_POLL_S = 0.5
_LOCALHOST = "127.0.0.1"


def check_ray() -> None:
    """Raise unless Ray is installed.

    Raises:
        MissingFileError: If it is not.
    """
    if find_spec("ray") is None:
        raise MissingFileError("Ray", "this Python", "install the extra: pip install 'laploop[ray]'")


def collect_with_ray(config: AcquisitionConfig, out: Path, tissues: Sequence[int], written: Callable[[], None]) -> None:
    """Collect the missing pairs of some tissues, a task each.

    Runs on the cluster that `RAY_ADDRESS` names, whose machines must all see the store at the same path, or on one of
    `config.workers` processes that is started here, reachable from this machine alone, and stopped at the end. No statistics
    of use are sent.

    Raises:
        MissingFileError: If Ray is not installed.
        WorkerError: If the cluster cannot be reached or started.
    """
    check_ray()
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    # Ray would warn that it leaves the variables for accelerators alone from some version on; there are none here.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    import ray

    started = not ray.is_initialized()
    if started:
        _connect(ray, config.workers)
    try:
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
    finally:
        if started:
            ray.shutdown()


def _connect(ray: Any, workers: int) -> None:
    cluster = os.environ.get("RAY_ADDRESS")
    options: dict[str, Any] = {"address": cluster}
    if not cluster:
        options = {"num_cpus": workers, "include_dashboard": False, "_node_ip_address": _LOCALHOST}
    try:
        ray.init(logging_level=logging.ERROR, log_to_driver=False, configure_logging=False, **options)
    except Exception as error:
        ray.shutdown()
        what = f"reach the Ray cluster at {cluster}" if cluster else "start a Ray cluster"
        raise WorkerError(f"cannot {what}: {str(error).partition(chr(10))[0] or type(error).__name__}") from error
