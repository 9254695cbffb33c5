"""A point at rest before a scope that pivots at its trocar, in closed form; frames arrive late."""

import numpy as np
import pytest

from laploop.control.controllers.image_servo import ImageServoConfig, ImageServoController
from laploop.control.controllers.registry import make_controller
from laploop.control.messages import ControlInput
from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthEstimate, DepthFrame

TICK_NS, FRAME_NS = 8_000_000, 40_000_000
TROCAR = np.array([0.0025, 0.0, -0.2])


def run(rig, servo, seconds, delay_frames, start=(0.001, 0.0, 0.085)):
    """Return the point's place in the camera's frame at every tick, (n, 3)."""
    camera, point, places, newest = rig.camera, np.array(start), [], None
    inserted = float(np.linalg.norm(TROCAR - [0.5 * rig.baseline_m, 0.0, 0.0]))
    for tick in range(round(seconds * 125)):
        now_ns = tick * TICK_NS
        places.append(point)
        captured_ns = now_ns - delay_frames * FRAME_NS
        if captured_ns >= 0 and captured_ns % FRAME_NS == 0:
            seen = places[captured_ns // TICK_NS]
            depth_mm = np.full((camera.height, camera.width), 1e3 * seen[2], np.float32)
            estimate = DepthEstimate(depth_mm=depth_mm, valid=np.ones(depth_mm.shape, bool))
            frame = DepthFrame(
                estimate=estimate, index=tick, captured_ns=captured_ns, available_ns=now_ns, world_from_camera=np.eye(4)
            )
            newest = frame, camera.project(seen)
        state = ControlInput(
            now_ns=now_ns,
            depth=None if newest is None else newest[0],
            target_pixel=np.zeros(2),
            tip_in_camera=np.zeros(3),
            tip_velocity_in_camera=np.zeros(3),
            trocar_in_camera=TROCAR,
            contact_force_n=0.0,
            scope_trocar_in_camera=TROCAR,
            marker_pixel=None if newest is None else newest[1],
        )
        velocity = servo.command(state)
        across = -(1.0 + point[2] / inserted) * velocity[:2]
        way = point - [0.5 * rig.baseline_m, 0.0, 0.0]
        along = float(way[:2] @ velocity[:2]) / inserted - velocity[2]
        point = point + 0.008 * np.array([*across, along])
    return np.array(places)


def servo_of(rig, **fields):
    return ImageServoController.of(rig, max_speed_mps=1.0, **fields)


@pytest.mark.parametrize(("delay_frames", "border"), [(1, 25.0), (2, 15.45), (3, 11.13)])
def test_the_border_of_stability_is_that_of_a_delayed_integrator(rig, delay_frames, border):
    for factor, grows in ((0.97, False), (1.03, True)):
        across = np.abs(run(rig, servo_of(rig, gain_per_s=factor * border), 6.0, delay_frames)[:, 0])
        assert (across[-125:].max() > across[250:375].max()) == grows


def test_a_smith_predictor_takes_the_delay_out_of_the_loop(rig):
    plain = run(rig, servo_of(rig, gain_per_s=5.0), 4.0, 8)
    smith = run(rig, servo_of(rig, gain_per_s=5.0, compensation="smith"), 4.0, 8)
    told_wrong = run(rig, servo_of(rig, gain_per_s=5.0, compensation="smith", told_delay_s=0.1), 4.0, 8)
    assert plain[:, 0].min() < -0.001
    assert smith[:, 0].min() > -1e-5
    assert abs(smith[-1, 0]) < 1e-5
    assert -0.0007 < told_wrong[:, 0].min() < -0.0003


def test_it_goes_to_the_working_distance_unless_told_not_to(rig):
    start = (0.001, 0.0, 0.095)
    assert run(rig, servo_of(rig), 3.0, 1, start)[-1, 2] == pytest.approx(0.085, abs=1e-4)
    assert run(rig, servo_of(rig, hold_distance=False), 3.0, 1, start)[-1, 2] == pytest.approx(0.095, abs=1e-4)


def test_it_stands_still_before_the_first_frame_and_keeps_to_its_speed(rig):
    servo = ImageServoController(rig, ImageServoConfig(gain_per_s=100.0, max_speed_mps=0.02))
    places = run(rig, servo, 0.2, 2, start=(0.01, 0.0, 0.085))
    assert (places[:11] == places[0]).all()
    assert np.abs(np.diff(places[:, 0])).max() <= 0.02 * 0.008 * (1.0 + 0.085 / 0.2) + 1e-12


def test_it_has_a_name_and_no_use_for_a_predictor(rig):
    assert isinstance(make_controller("image-servo", rig, arguments={"gain_per_s": 2.0}), ImageServoController)
    with pytest.raises(InvalidValueError, match="predictor"):
        make_controller("image-servo", rig, prediction="rhythms")
