"""Collects stripe frames paired with captures of the reference camera, like the automated program of the paper."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path

from laploop.errors import InvalidValueError, OutputError
from laploop.perception.calibration.calibration_file import load_calibration
from laploop.perception.data.pair_store import PairStore
from laploop.studies.acquisition.config import AcquisitionConfig
from laploop.studies.acquisition.ray import collect_with_ray
from laploop.studies.acquisition.station import collect_tissue, reference_optics
from laploop.studies.calibration.run import calibrate_bench
from laploop.studies.ray_cluster import ray_cluster
from laploop.workers import run_in_workers

Progress = Callable[[str, float], AbstractContextManager[Callable[[float], None]]]
"""Given what is counted and how many there are, yields a function to be called with the number done."""


@contextmanager
def no_progress(_what: str, _total: float) -> Iterator[Callable[[float], None]]:
    """Show nothing."""
    yield lambda _: None


def collect_pairs(
    config: AcquisitionConfig, out: Path, *, calibration: Path | None = None, progress: Progress = no_progress
) -> Path:
    """Collect pairs into the store `out` and return its path; resume where an earlier run stopped.

    Pair i depends on the configuration, the calibration and i alone: not on the engine, the number of workers, or
    interruptions. A resumed run uses the calibration that the store holds.

    Args:
        config: The plan.
        out: The store; made where it does not exist.
        calibration: Calibration file to use; by default the bench is calibrated first.
        progress: Shows the progress of the calibration and of the pairs.

    Raises:
        OutputError: If `out` cannot be written, or holds a collection of another configuration or calibration.
        MissingFileError: If there is no such calibration, or no Ray for the engine of that name.
        InvalidValueError: If the calibration is not valid.
        DatasetError: If `out` is a damaged data set, or one of another format.
        WorkerError: If the workers or the cluster cannot be started.
        SimulationError: If a tissue does not settle.
    """
    with ray_cluster(config.workers) if config.engine == "ray" else nullcontext():
        store = _open_or_create(config, out, calibration, progress)
        done = store.done()
        tissues = sorted({int(tissue) for tissue in config.tissue_of_pair[~done]})
        with progress("pairs", config.pairs) as report:

            def written(*_: int) -> None:
                report(store.count_done())

            written()
            if config.engine == "ray":
                collect_with_ray(config, out, tissues, written)
            elif config.workers == 1:
                for tissue in tissues:
                    collect_tissue(config, out, tissue, written)
            else:
                run_in_workers(partial(collect_tissue, config, out), tissues, config.workers, written, waiting=written)
            written()
    return out


def _open_or_create(config: AcquisitionConfig, out: Path, calibration: Path | None, progress: Progress) -> PairStore:
    """Open the store of an earlier run of the same plan, or calibrate and make a new one."""
    given = None if calibration is None else load_calibration(calibration)
    digest = None if calibration is None else hashlib.sha256(calibration.read_bytes()).hexdigest()
    recipe = {**config.recipe, "calibration_file_sha256": digest}
    if out.exists():
        store = PairStore.open(out, writable=True)
        different = sorted(name for name in recipe if store.config.get(name) != recipe[name])
        if different:
            raise OutputError(
                f"{out} holds a collection of another configuration (different: {', '.join(different)}); give a new folder"
            )
        store.remove_left_behind()
        return store
    intrinsics, scope = reference_optics(config).intrinsics, config.bench.scope
    if given is not None and (given.scope.intrinsics.width, given.scope.intrinsics.height) != (scope.width, scope.height):
        size = (given.scope.intrinsics.width, given.scope.intrinsics.height)
        raise InvalidValueError(f"image of the scope in {calibration}", size, f"{(scope.width, scope.height)}, the bench's")
    if given is None:
        with progress("views of the calibration board", config.calibration.pictures) as report:
            given = calibrate_bench(config.calibration, report).stereo
    return PairStore.create(
        out,
        optics=scope,
        reference_intrinsics=intrinsics,
        true_scope_from_reference=config.bench.scope_from_reference,
        calibration=given,
        tissue_seed=config.tissue_of_pair,
        split=config.split_of_pair,
        tool_in_view=config.tool_in_view,
        config=recipe,
    )
