import mujoco
import numpy as np

from laploop.assets.laparoscope import CAMERA, PROJECTOR, SHAFT_TIP, build_laparoscope
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import LAPAROSCOPE


def compiled(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_channels_are_parallel_and_a_baseline_apart_on_the_tips_face():
    _, data = compiled(build_laparoscope())
    baseline = ScopeOptics().baseline_m
    np.testing.assert_allclose(data.site(PROJECTOR).xpos - data.site(CAMERA).xpos, [baseline, 0.0, 0.0], atol=1e-15)
    assert data.site(CAMERA).xpos[2] == LAPAROSCOPE.length_m
    for name in (CAMERA, PROJECTOR, SHAFT_TIP):
        np.testing.assert_array_equal(data.site(name).xmat.reshape(3, 3), np.eye(3))


def test_mujocos_camera_is_half_a_turn_about_x_from_the_channel():
    model, data = compiled(build_laparoscope())
    np.testing.assert_allclose(data.cam(CAMERA).xmat.reshape(3, 3), np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    np.testing.assert_allclose(data.cam(CAMERA).xpos, data.site(CAMERA).xpos, atol=1e-15)
    # A square image: the vertical field of view is the horizontal one, in degrees.
    np.testing.assert_allclose(model.cam_fovy[0], 60.0, rtol=1e-12)
