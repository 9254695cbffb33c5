import numpy as np
import pytest

from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.optics.exposure_control import ExposureControl
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError


@pytest.fixture(scope="module")
def scope(rig):
    return StripeCamera(rig)


def level(image, bits=8):
    """Percentile that the default control looks at, as a fraction of full scale."""
    return np.percentile(image, 95.0) / (2**bits - 1)


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("start_s", [3e-4, 0.015, 0.029])
@pytest.mark.parametrize("z", [0.06, 0.11])
def test_brightness_settles_at_the_target_within_six_frames(scope, make_plane, z, start_s, bits):
    control = ExposureControl(gain=0.8)
    scope.attach_geometry(make_plane(z, object_id=ObjectId.TISSUE))
    scope.set_optics(StripeOptics(exposure_s=start_s, bits=bits, exposure_control=control))
    rng = np.random.default_rng(1)
    exposures, levels = [], []
    for _ in range(12):
        exposures.append(scope.optics.exposure_s)
        levels.append(level(scope.capture(None, np.eye(4), rng).image, bits))
    at_limit = exposures[-1] == control.longest_s
    for reached in levels[6:]:
        assert reached == pytest.approx(control.target, rel=0.05) or (at_limit and reached < control.target)
    assert len(set(exposures[8:])) == 1  # noise does not make it hunt


def test_exposure_follows_a_camera_that_moves_away(scope, make_plane):
    control, rng = ExposureControl(gain=0.8), np.random.default_rng(2)
    scope.set_optics(StripeOptics(exposure_control=control))
    levels = []
    for z in np.linspace(0.06, 0.09, 30):
        scope.attach_geometry(make_plane(z, object_id=ObjectId.TISSUE))
        levels.append(level(scope.capture(None, np.eye(4), rng).image))
    assert np.abs(np.array(levels[5:]) / control.target - 1.0).max() < 0.1


def test_without_control_exposure_stays_as_it_is(scope, make_plane):
    scope.attach_geometry(make_plane(0.05, object_id=ObjectId.TISSUE))
    scope.set_optics(StripeOptics())
    scope.capture(None, np.eye(4), None)
    assert scope.optics == StripeOptics()


def test_exposure_stays_in_its_range_and_takes_limited_steps():
    control = ExposureControl(gain=0.8, shortest_s=0.001, longest_s=0.02)
    dark, bright = np.zeros((8, 8), dtype=np.uint8), np.full((8, 8), 255, dtype=np.uint8)
    assert control.next_exposure_s(0.02, dark, 8) == 0.02
    exposures = [0.02]
    for _ in range(6):
        exposures.append(control.next_exposure_s(exposures[-1], bright, 8))
    assert exposures[1] == pytest.approx(0.02 * 4.0**-0.8)
    assert exposures[-1] == 0.001


def test_an_image_near_the_target_changes_nothing():
    control = ExposureControl(gain=0.8, target=0.5, tolerance=0.05)
    assert control.next_exposure_s(0.015, np.full((4, 4), 130, dtype=np.uint8), 8) == 0.015
    assert control.next_exposure_s(0.015, np.full((4, 4), 150, dtype=np.uint8), 8) < 0.015
    darker = control.next_exposure_s(0.015, np.full((4, 4), 64, dtype=np.uint8), 8)
    assert darker == pytest.approx(0.015 * (127.5 / 64) ** 0.8)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("target", {"target": 1.0}),
        ("percentile", {"percentile": 101.0}),
        ("gain", {"gain": 1.1}),
        ("shortest_s", {"shortest_s": 0.02, "longest_s": 0.01}),
    ],
)
def test_impossible_controls_are_refused_by_name(name, values):
    with pytest.raises(InvalidValueError, match=name):
        ExposureControl(**values)
