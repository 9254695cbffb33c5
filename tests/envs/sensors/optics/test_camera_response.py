from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.stripe_mask import StripeMask
from laploop.envs.sensors.optics.camera_response import CameraResponse
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError


@pytest.mark.parametrize("bits", [8, 12])
def test_grey_values_follow_gain_and_gamma(rig, make_plane, bits):
    camera = StripeCamera(replace(rig, mask=StripeMask(profile=(1.0,))), threads=1)
    camera.attach_geometry(make_plane(0.09))
    for response in (CameraResponse(), CameraResponse(gain=2.0), CameraResponse(gain=0.5, gamma=2.2)):
        optics = StripeOptics(bits=bits, response=response)
        camera.set_optics(optics)
        capture = camera.capture(None, np.eye(4), None)
        full = 2**bits - 1
        signal = capture.electrons.astype(float) / optics.full_well_electrons
        expected = np.minimum(full * (response.gain * signal) ** (1.0 / response.gamma), full)
        assert np.abs(capture.image - expected).max() < 0.502


def test_the_signal_of_a_grey_value_is_the_inverse():
    response = CameraResponse(gain=1.5, gamma=2.2)
    assert (1.5 * response.signal(0.3)) ** (1.0 / 2.2) == pytest.approx(0.3)


def test_noise_below_the_black_level_stays_black(rig, make_plane):
    camera = StripeCamera(rig, StripeOptics(led_power_w=0.0, response=CameraResponse(gamma=2.2)), threads=1)
    camera.attach_geometry(make_plane(0.09))
    image = camera.capture(None, np.eye(4), np.random.default_rng(0)).image
    assert 0.4 < (image == 0).mean() < 0.6


def test_what_no_camera_does_is_refused():
    with pytest.raises(InvalidValueError, match="gamma"):
        CameraResponse(gamma=0.0)
