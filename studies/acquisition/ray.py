"""The same acquisition as tasks of a Ray cluster."""

from collections.abc import Callable, Sequence
from pathlib import Path

from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.station import collect_tissue

_POLL_S = 0.5


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
