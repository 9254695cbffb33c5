"""Pressing on a plane with a spring behind it; the tip integrates its velocity."""

import numpy as np
import pytest

from laploop.control.controllers.palpate import PalpateController, PalpateControllerConfig
from laploop.errors import InvalidValueError


def held(log):
    return np.array([force for force, phase in zip(log.forces, log.phases, strict=True) if phase == "hold"])


@pytest.mark.parametrize(("stiffness", "late_ticks"), [(100.0, 0), (500.0, 0), (250.0, 9)])
def test_force_is_reached_and_held_on_still_tissue(rig, make_plant, stiffness, late_ticks):
    log = make_plant(stiffness=stiffness, late_ticks=late_ticks).run(PalpateController(rig), 7.0)
    assert log.phase_order[-4:] == ["descend", "approach", "press", "hold"]
    assert np.abs(held(log) - 0.5).max() <= 0.1 + 1e-9  # newtons
    assert len(held(log)) > 300
    assert max(log.forces) < 0.55  # newtons: no overshoot to speak of
    assert log.sideways[-1] < 1.5e-4  # metres: the search along the ray, seen from the normal


@pytest.mark.parametrize(("stiffness", "late_ticks"), [(100.0, 0), (500.0, 0), (250.0, 9)])
def test_breathing_and_beating_never_raise_the_force_above_2_n(rig, make_plant, breathing, stiffness, late_ticks):
    plant = make_plant(stiffness=stiffness, late_ticks=late_ticks)
    plant.motion = breathing
    log = plant.run(PalpateController(rig), 16.0)
    assert max(log.forces) < 1.2  # newtons; the tool withdraws above
    late = np.abs(log.since(10.0, log.forces) - 0.5)
    assert np.mean(late <= 0.1) > 0.95


@pytest.mark.parametrize("bias", [-0.0015, 0.0015])
def test_depth_error_does_not_change_the_force(rig, make_plant, bias):
    plant = make_plant()
    plant.spoil = lambda _, depth, valid: (depth + bias, valid)
    log = plant.run(PalpateController(rig), 7.0)
    assert np.mean(np.abs(held(log) - 0.5) <= 0.1) > 0.95


def test_force_above_the_withdrawal_makes_the_tool_try_again(rig, make_plant):
    plant = make_plant()
    plant.sensor = lambda time_s, force: 3.0 if 4.0 < time_s < 4.05 else force
    controller = PalpateController(rig)
    log = plant.run(controller, 9.0)
    assert controller.alarm
    assert "retreat" in log.phases
    assert "stopped" not in log.phases
    assert log.phases[-1] == "hold"
    controller.reset()
    assert not controller.alarm


def test_saturated_sensor_ends_the_task_clear_of_the_tissue(rig, make_plant):
    plant = make_plant()
    plant.sensor = lambda time_s, force: 50.0 if time_s > 4.0 else force
    log = plant.run(PalpateController(rig), 7.0)
    assert log.phases[-1] == "stopped"
    assert log.gaps[-1] > 0.003  # metres
    np.testing.assert_array_equal(log.commands[-1], np.zeros(3))
    assert max(log.forces) < 0.6  # newtons


def test_sensor_that_reads_nothing_presses_no_deeper_than_allowed(rig, make_plant):
    plant = make_plant(stiffness=120.0)
    plant.sensor = lambda *_: 0.0
    log = plant.run(PalpateController(rig), 7.0)
    # Without a touch the search ends 3 mm beyond the seen surface, along the viewing ray.
    assert -0.0035 < min(log.gaps) < -0.0025
    assert max(log.forces) < 0.45  # newtons


def test_sensor_that_fades_while_pressing_meets_the_deepest_indentation(rig, make_plant):
    plant = make_plant(stiffness=100.0)
    plant.sensor = lambda time_s, force: force if time_s < 4.0 else 0.0
    log = plant.run(PalpateController(rig), 8.0)
    assert max(log.forces) < 1.3  # newtons: 12 mm of indentation
    assert -min(log.gaps) < 0.0125  # metres


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"force_n": 1.5}, r"force_n is 1\.5; allowed: contact_force_n"),
        ({"band_n": np.nan}, "band_n"),
    ],
)
def test_bad_configuration_is_named(options, name):
    with pytest.raises(InvalidValueError, match=name):
        PalpateControllerConfig(**options)
