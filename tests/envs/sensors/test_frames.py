import mujoco
import numpy as np

from laploop.envs.sensors.frames import world_from_cv_camera


def test_camera_looks_along_its_z_with_y_down():
    xml = """
    <mujoco><worldbody>
      <camera name="eye" pos="0.1 0.2 0.3" xyaxes="1 0 0 0 1 0"/>
      <camera name="tilted" pos="0 0 1" xyaxes="0 1 0 -0.6 0 0.8"/>
    </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    down = world_from_cv_camera(data.cam_xpos[0], data.cam_xmat[0])
    np.testing.assert_allclose(down[:3, :3], np.diag([1.0, -1.0, -1.0]), atol=1e-12)
    np.testing.assert_allclose(down[:3, 3], [0.1, 0.2, 0.3], atol=1e-12)
    tilted = world_from_cv_camera(data.cam_xpos[1], data.cam_xmat[1].reshape(3, 3))
    np.testing.assert_allclose(tilted[:3, :3].T @ tilted[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(tilted[:3, :3]) > 0.0
    np.testing.assert_allclose(tilted[:3, 1], [0.6, 0.0, -0.8], atol=1e-12)
