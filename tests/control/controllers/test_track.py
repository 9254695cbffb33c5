"""Tracking over a moving plane in closed form; the tip integrates its velocity."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.control.controllers.safe_approach import SafeApproachConfig
from laploop.control.controllers.track import TrackController, TrackControllerConfig
from laploop.control.prediction.motion_predictor import Prediction
from laploop.control.targeting.targeting import TargetingConfig
from laploop.errors import InvalidValueError

STANDOFF = TrackControllerConfig().standoff_m


def rms_mm(log, begin_s):
    return 1e3 * float(np.sqrt(np.mean((log.since(begin_s, log.gaps) - STANDOFF) ** 2)))


def test_still_tissue_is_hovered_over_at_the_standoff(rig, make_plant):
    log = make_plant().run(TrackController(rig), 5.0)
    assert log.phase_order == ["wait", "travel", "descend", "hold"]
    assert rms_mm(log, 4.0) < 0.01  # depth is exact to float32
    assert log.since(4.0, log.sideways).max() < 2e-5  # metres
    assert max(log.forces) == 0.0


@pytest.mark.parametrize("late_ticks", [0, 8])
def test_rhythms_hold_the_standoff_across_100_ms_where_held_depth_does_not(rig, make_plant, breathing, late_ticks):
    errors = {}
    for prediction in ("none", "rhythms"):
        plant = make_plant(latency_ns=100_000_000, late_ticks=late_ticks)
        plant.motion = breathing
        config = TrackControllerConfig(targeting=TargetingConfig(prediction=prediction))
        log = plant.run(TrackController(rig, config), 16.0)
        assert log.phase_order[-1] == "hold"
        assert max(log.forces) == 0.0
        errors[prediction] = rms_mm(log, 10.0)
    assert errors["rhythms"] < 0.05  # millimetres; 0.01 measured
    assert errors["rhythms"] < errors["none"] / 3.0


def test_target_says_when_it_is_predicted(rig, make_plant, breathing):
    plant = make_plant(latency_ns=100_000_000)
    plant.motion = breathing
    controller = TrackController(rig)
    plant.run(controller, 1.0)
    assert controller.target is not None
    assert not controller.target.predicted
    controller.reset()
    assert controller.target is None
    plant.run(controller, 12.0)
    assert controller.target.predicted


def test_predictor_of_the_users_is_used_where_it_is_trusted(rig, make_plant, breathing):
    class Prophet:
        def reset(self):
            pass

        def update(self, measured, captured_ns):
            return True

        def predict(self, at_ns):
            value, after = (breathing(1e-9 * at_ns + delay) - breathing(0.0) for delay in (0.0, 1e-3))
            return Prediction(value=value, velocity=1e3 * (after - value), sigma=0.0, trusted=True)

    plant = make_plant(latency_ns=100_000_000)
    plant.motion = breathing
    assert rms_mm(plant.run(TrackController(rig, predictor=Prophet()), 6.0), 4.0) < 0.02


@pytest.mark.parametrize("answer", [None, 0.001, Prediction(value=np.nan, velocity=0.0, trusted=True)])
def test_unusable_answer_of_a_predictor_is_refused_and_shown(rig, make_plant, answer):
    class Broken:
        def reset(self):
            pass

        def update(self, measured, captured_ns):
            return True

        def predict(self, at_ns):
            return answer

    controller = TrackController(rig, predictor=Broken())
    with pytest.raises(InvalidValueError, match=r"answer of Broken\.predict is .*; allowed: a Prediction whose value \(m\)"):
        make_plant().run(controller, 1.0)


def test_bump_makes_the_tool_withdraw_and_come_back(rig, make_plant):
    plant = make_plant()
    plant.sensor = lambda time_s, force: 0.5 if 3.0 < time_s < 3.1 else force
    log = plant.run(TrackController(rig), 6.0)
    assert "retreat" in log.phases
    assert log.phases[-1] == "hold"
    during = log.since(3.1, log.gaps)[:12]
    assert during.max() > STANDOFF + 0.001  # metres


def test_commands_keep_to_the_highest_speed(rig, make_plant, breathing):
    plant = make_plant()
    plant.motion = breathing
    log = plant.run(TrackController(rig), 4.0)
    assert np.linalg.norm(log.commands, axis=1).max() <= 0.06 * (1.0 + 1e-9)


def test_reset_repeats_to_the_bit(rig, make_plant, breathing):
    controller, plant = TrackController(rig), make_plant()
    plant.motion = breathing
    first = plant.run(controller, 8.0)
    controller.reset()
    np.testing.assert_array_equal(first.commands, plant.run(controller, 8.0).commands)


@pytest.mark.parametrize(("options", "name"), [({"standoff_m": 0.02}, "standoff_m"), ({"approach_speed_mps": 0.0}, "speed")])
def test_bad_configuration_is_named(options, name):
    with pytest.raises(InvalidValueError, match=name):
        TrackControllerConfig(**options)


def test_forces_of_the_approach_must_be_in_order():
    with pytest.raises(InvalidValueError, match=r"withdraw_force_n is 1\.2; allowed: at least bump_force_n \(3\.0\)"):
        replace(SafeApproachConfig(), bump_force_n=3.0)
