from dataclasses import replace

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


def settle(scope, control, optics, rng, frames=12):
    """Exposures and levels of successive frames."""
    history = []
    for _ in range(frames):
        scope.set_optics(optics)
        image = scope.capture(None, np.eye(4), rng).image
        history.append((optics.exposure_s, control.level(optics, image)))
        optics = control.next(optics, image)
    return history, optics


@pytest.mark.parametrize("bits", [8, 12])
@pytest.mark.parametrize("start_s", [3e-4, 0.015, 0.029])
@pytest.mark.parametrize("z", [0.06, 0.11])
def test_brightness_settles_at_the_target_within_six_frames(scope, make_plane, z, start_s, bits):
    control = ExposureControl()
    scope.attach_geometry(make_plane(z, object_id=ObjectId.TISSUE))
    history, _ = settle(scope, control, StripeOptics(exposure_s=start_s, bits=bits), np.random.default_rng(1))
    at_limit = history[-1][0] == control.longest_s
    for _, level in history[6:]:
        assert level == pytest.approx(control.target, rel=0.05) or (at_limit and level < control.target)
    assert len({exposure for exposure, _ in history[8:]}) == 1  # it rests: noise does not make it hunt


def test_exposure_follows_a_camera_that_moves_away(scope, make_plane):
    control, optics, rng = ExposureControl(), StripeOptics(), np.random.default_rng(2)
    levels = []
    for z in np.linspace(0.06, 0.09, 30):
        scope.attach_geometry(make_plane(z, object_id=ObjectId.TISSUE))
        scope.set_optics(optics)
        image = scope.capture(None, np.eye(4), rng).image
        levels.append(control.level(optics, image))
        optics = control.next(optics, image)
    assert np.abs(np.array(levels[5:]) / control.target - 1.0).max() < 0.1


def test_exposure_stays_in_its_range(scope, make_plane):
    scope.attach_geometry(make_plane(0.15, object_id=ObjectId.STAGE))
    control = ExposureControl(shortest_s=0.001, longest_s=0.02)
    _, optics = settle(scope, control, StripeOptics(), np.random.default_rng(3))
    assert optics.exposure_s == 0.02
    assert control.next(optics, np.zeros((8, 8), dtype=np.uint8)) == optics
    bright = np.full((8, 8), 255, dtype=np.uint8)
    steps = [StripeOptics(exposure_s=0.02)]
    for _ in range(6):
        steps.append(control.next(steps[-1], bright))
    assert steps[1].exposure_s == pytest.approx(0.02 * 4.0**-0.8)
    assert steps[-1].exposure_s == 0.001


def test_an_image_near_the_target_changes_nothing():
    control, optics = ExposureControl(target=0.5, tolerance=0.05), StripeOptics()
    assert control.is_settled(optics, np.full((4, 4), 130, dtype=np.uint8))
    assert not control.is_settled(optics, np.full((4, 4), 150, dtype=np.uint8))
    changed = control.next(optics, np.full((4, 4), 64, dtype=np.uint8))
    assert changed.exposure_s == pytest.approx(optics.exposure_s * (127.5 / 64) ** 0.8)
    assert replace(changed, exposure_s=optics.exposure_s) == optics


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("target", {"target": 1.0}),
        ("percentile", {"percentile": 101.0}),
        ("gain", {"gain": 0.0}),
        ("longest_s", {"shortest_s": 0.02, "longest_s": 0.01}),
    ],
)
def test_impossible_controls_are_refused_by_name(name, values):
    with pytest.raises(InvalidValueError, match=name):
        ExposureControl(**values)
    with pytest.raises(InvalidValueError, match="size of image"):
        ExposureControl().next(StripeOptics(), np.zeros((0, 4), dtype=np.uint8))
