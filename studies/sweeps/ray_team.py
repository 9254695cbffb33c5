"""The same jobs as tasks of a Ray cluster; needs the extra `laploop[ray]`."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from laploop.studies.ray_cluster import ray_cluster
from laploop.studies.sweeps.process_team import ATTEMPTS

Job = TypeVar("Job")
Result = TypeVar("Result")


def run_on_ray(
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    workers: int,
    done: Callable[[Job, Result], None],
    died: Callable[[Job, str], None],
    *,
    address: str | None = None,
) -> None:
    """Do jobs as `run_in_team` does, on a cluster: the one at the address, or one of this machine alone.

    Raises:
        MissingFileError: If Ray is not installed.
        WorkerError: If the cluster cannot be reached or started.
    """
    with ray_cluster(workers, address):
        import ray

        task = ray.remote(work).options(max_retries=ATTEMPTS - 1)
        job_of = {task.remote(job): job for job in jobs}
        pending = list(job_of)
        while pending:
            finished, pending = ray.wait(pending, num_returns=1)
            for reference in finished:
                job = job_of[reference]
                try:
                    result = ray.get(reference)
                except ray.exceptions.RayTaskError as error:
                    raise error.cause from None
                except ray.exceptions.RayError as error:
                    died(job, f"its worker process died {ATTEMPTS} times: {str(error).strip().partition(chr(10))[0]}")
                else:
                    done(job, result)
