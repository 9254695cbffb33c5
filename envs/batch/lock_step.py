"""Many runs of the loop in lock step: all go on until each waits for physics, which is then computed for all at once."""

from collections.abc import Mapping
from typing import TypeVar

from laploop.envs.batch.stepper import Stepper
from laploop.envs.theatre.physics_call import PhysicsCall, PhysicsRun

T = TypeVar("T")


def run_in_lock_step(runs: Mapping[int, PhysicsRun[T]], stepper: Stepper) -> tuple[dict[int, T], dict[int, Exception]]:
    """Run all to their ends.

    A run that fails does not keep the others from theirs.

    Args:
        runs: By the number of the environment.
        stepper: Computes the physics.

    Returns:
        The result of each run that has one, and the error of each that failed.
    """
    results: dict[int, T] = {}
    errors: dict[int, Exception] = {}
    under_way = dict(runs)
    while under_way:
        calls: list[PhysicsCall] = []
        for number, run in list(under_way.items()):
            try:
                calls.append(next(run))
            except StopIteration as end:
                results[number] = end.value
                del under_way[number]
            except Exception as error:  # noqa: BLE001 - whoever asked for the runs raises it, with the environment's number
                errors[number] = error
                del under_way[number]
        stepper.do(calls)
    return results, errors
