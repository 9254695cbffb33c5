"""Scanning along a path over a moving plane in closed form; the tip integrates its velocity."""

import numpy as np
import pytest

from laploop.assets.shafts import INSTRUMENT
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.scan import ScanController, ScanControllerConfig
from laploop.control.controllers.scan_path import ScanPath
from laploop.control.targeting.surface_patch import SurfacePatch
from laploop.errors import InvalidValueError


@pytest.fixture
def plant(make_plant):
    plant = make_plant()
    angle = np.linspace(0.0, 1.5 * np.pi, 31)
    # About 60 mm on the surface; it starts at the target's pixel.
    plant.path = plant.pixel + 25.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
    return plant


def standoff_errors_mm(log, phases=("scan",)):
    return 1e3 * np.array([gap - 0.003 for gap, phase in zip(log.gaps, log.phases, strict=True) if phase in phases])


def test_still_tissue_is_scanned_to_the_end(rig, plant):
    controller = ScanController(rig)
    log = plant.run(controller, 12.0)
    assert log.phase_order == ["wait", "travel", "descend", "lower", "scan", "done"]
    assert np.abs(standoff_errors_mm(log)).max() < 0.1  # one tick's way when the lowering ends
    assert max(log.forces) == 0.0
    assert controller.progress == 1.0
    # Where the path is drawn: every pixel of it has had the ball's foot over it.
    feet = np.array([tip for tip, phase in zip(log.tips, log.phases, strict=True) if phase == "scan"])
    feet = feet - (0.003 + INSTRUMENT.tip_radius_m) * plant.normal
    pixels = rig.camera.project(feet)
    off = np.linalg.norm(pixels[:, None] - plant.path[None], axis=2)
    # Pixels: 0.6 mm, as a chord of the circle is off between its ends, and one for where the scan begins and ends.
    assert off.min(axis=0)[1:-1].max() < 1.5
    beyond = off.argmin(axis=1) == len(off[0]) - 1
    assert off.min(axis=1)[~beyond].max() < 3.0
    # It goes on beyond the end by `overrun_m`, on the surface; a tenth of that is for the last control periods.
    end = rig.camera.unproject(plant.path[-1], 1.0)
    end *= (plant.normal @ feet[-1]) / (plant.normal @ end)
    np.testing.assert_allclose(np.linalg.norm(feet[-1] - end), ScanControllerConfig().overrun_m, rtol=0.1)


def test_breathing_and_beating_tissue_is_scanned_at_the_standoff(rig, plant, breathing):
    plant.motion = breathing
    log = plant.run(ScanController(rig), 14.0)
    errors = standoff_errors_mm(log)
    assert log.phases[-1] == "done"
    assert np.sqrt(np.mean(errors**2)) < 0.5
    assert max(log.forces) == 0.0


def test_bump_lets_the_scan_go_on_where_it_was(rig, plant):
    plant.sensor = lambda time_s, force: 0.5 if 5.0 < time_s < 5.1 else force
    controller = ScanController(rig)
    log = plant.run(controller, 16.0)
    assert "retreat" in log.phases
    assert log.phases[-1] == "done"
    order = log.phase_order
    assert order[-3:] == ["lower", "scan", "done"]


def test_perception_that_stops_makes_the_tool_back_off(rig, plant, breathing):
    plant.motion = breathing
    plant.spoil = lambda time_s, depth, valid: None if time_s > 4.5 else (depth, valid)
    log = plant.run(ScanController(rig), 9.0)
    assert log.phases[-1] == "back-off"
    assert max(log.forces) == 0.0


def test_force_sensor_that_fails_keeps_the_tool_off(rig, plant):
    plant.sensor = lambda time_s, force: np.nan if time_s > 4.5 else force
    plant.limit = lambda velocity, tip: velocity if tip[2] > 0.03 or velocity[2] > 0.0 else np.zeros(3)
    log = plant.run(ScanController(rig), 7.0)
    assert log.phases[-1] == "retreat"
    assert log.gaps[-1] > 0.02


def test_path_that_is_not_shown_is_waited_for(rig, plant):
    def spoil(time_s, depth, valid):
        seen = valid.copy()
        if time_s < 1.0:
            seen[150:] = False
        return depth, seen

    plant.spoil = spoil
    log = plant.run(ScanController(rig), 13.0)
    assert set(log.since(0.0, log.phases)[: round(1.0 * 125)]) == {"wait"}
    assert log.phases[-1] == Phase.DONE


def test_reset_repeats_to_the_bit(rig, plant):
    controller = ScanController(rig)
    first = plant.run(controller, 4.0)
    controller.reset()
    assert controller.progress == 0.0
    np.testing.assert_array_equal(first.commands, plant.run(controller, 4.0).commands)


@pytest.mark.parametrize("path", [None, np.zeros((1, 2)), np.zeros((4, 3)), np.full((4, 2), np.nan)])
def test_missing_or_bad_path_is_named(rig, plant, path):
    plant.path = path
    with pytest.raises(InvalidValueError, match="path_pixels"):
        plant.run(ScanController(rig), 0.1)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"waiting_error_m": 0.0001}, "waiting_error_m"),
        ({"overrun_m": 0.0}, "overrun_m"),
        ({"standoff_m": 0.02}, "standoff_m"),
        ({"min_seen_fraction": 2.0}, "min_seen_fraction"),
    ],
)
def test_bad_configuration_is_named(options, name):
    with pytest.raises(InvalidValueError, match=name):
        ScanControllerConfig(**options)


def test_path_is_measured_along_the_surface():
    up = np.array([0.0, 0.0, -1.0])
    corners = [np.array(point) for point in ([0.0, 0.0, 0.1], [0.003, 0.0, 0.104], [0.003, 0.01, 0.104])]
    path = ScanPath([SurfacePatch(point=corner, normal=up, spread_m=0.0) for corner in corners])
    assert path.length_m == pytest.approx(0.015)
    np.testing.assert_allclose(path.place(0.01)[0], [0.003, 0.005, 0.104])
    np.testing.assert_allclose(path.above(0.0, 0.002), [0.0, 0.0, 0.098])
    with pytest.raises(InvalidValueError, match="2 or more"):
        ScanPath([])


def test_path_goes_on_straight_along_the_surface_beyond_its_ends():
    tilted = np.array([0.0, -0.6, -0.8])
    along = np.array([0.0, 0.8, -0.6])
    path = ScanPath(
        [SurfacePatch(point=[0.0, 0.0, 0.1] + step * along, normal=tilted, spread_m=0.0) for step in (0.0, 0.004, 0.01)]
    )
    for beyond, expected in ((0.012, 0.012), (-0.003, -0.003)):
        point, normal = path.place(beyond)
        np.testing.assert_allclose(point, [0.0, 0.0, 0.1] + expected * along, atol=1e-12)
        np.testing.assert_allclose(normal, tilted)
