"""Where MuJoCo's camera convention ends and the computer-vision one begins."""

import numpy as np
from numpy.typing import NDArray

_CV_FROM_MUJOCO_AXES = np.array([1.0, -1.0, -1.0])


def world_from_cv_camera(cam_xpos: NDArray[np.float64], cam_xmat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the 4x4 `world_from_camera` of the computer-vision camera at a MuJoCo camera's pose.

    MuJoCo's camera looks along its -z with y up; ours looks along +z with y down. The x axes agree.

    Args:
        cam_xpos: `data.cam_xpos[i]`, (3,), metres; make the kinematics current first (`mj_camlight`).
        cam_xmat: `data.cam_xmat[i]`, (9,) row by row or (3, 3).
    """
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = np.reshape(cam_xmat, (3, 3)) * _CV_FROM_MUJOCO_AXES
    world_from_camera[:3, 3] = cam_xpos
    return world_from_camera
