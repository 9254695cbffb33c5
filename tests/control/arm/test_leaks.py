"""Arms and controllers are freed as soon as nobody holds them, without the garbage collector."""

import gc
import resource
import weakref
from pathlib import Path

import pytest

from laploop.assets.shafts import INSTRUMENT
from laploop.control.arm.model import ArmModel
from laploop.control.arm.rcm_controller import RcmController


@pytest.fixture
def no_collector():
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def use(tool):
    """Make an arm with its controller, move it, and return weak references to both and to their Pinocchio models."""
    arm = ArmModel(tool.model.world_from_base, INSTRUMENT)
    controller = RcmController(arm, tool.trocar_in_world)
    controller.reset(tool.home_q)
    controller.set_other_shaft(tool.world_from_shaft, INSTRUMENT)
    controller.step([0.0, 0.01, 0.0], 0.008)
    return [weakref.ref(one) for one in (arm, arm.model, controller, controller.configuration, controller.configuration.model)]


def test_fifty_controllers_and_their_models_are_freed_at_once(tool, no_collector):
    kept = [one for _ in range(50) for one in use(tool)]
    assert [one() for one in kept] == [None] * 250


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_controllers_made(tool, no_collector):
    def resident_mb():
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    sizes = []
    for _ in range(4):
        for _ in range(250):
            use(tool)
        sizes.append(resident_mb())
    # Megabytes in 500 controllers, once the allocator has what it needs; the models alone would take 10.
    assert sizes[-1] - sizes[1] < 3.0
