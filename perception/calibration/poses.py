"""Poses of boards and cameras, and their vectors for a solver."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.errors import InvalidValueError
from laploop.perception.calibration.results import CameraCalibration

Array = NDArray[np.float64]


def place_board(camera: CameraCalibration, corners: Array, points: Array) -> Array:
    """Return the pose camera_from_board, 4x4, that shows a board's `points` (n, 3) at `corners` (n, 2).

    Raises:
        InvalidValueError: If no pose does.
    """
    import cv2  # heavy, and only needed here

    d = camera.distortion
    coefficients = np.array([d.k1, d.k2, d.p1, d.p2, d.k3])
    found, turn, shift = cv2.solvePnP(points, corners, camera.intrinsics.matrix, coefficients, flags=cv2.SOLVEPNP_IPPE)
    if not found:
        raise InvalidValueError("corners of a view", corners.tolist(), "those of a board in front of the camera")
    turn, shift = cv2.solvePnPRefineLM(points, corners, camera.intrinsics.matrix, coefficients, turn, shift)
    pose: Array = vectors_as_poses(np.concatenate([turn.ravel(), shift.ravel()])[None])[0]
    return pose


def pose_as_vector(pose: Array) -> Array:
    """Return a rigid transform (4, 4) as a rotation vector and a translation, (6,)."""
    return np.concatenate([Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])


def vectors_as_poses(vectors: Array) -> Array:
    """Return rotation vectors and translations (n, 6) as rigid transforms (n, 4, 4)."""
    poses = np.tile(np.eye(4), (len(vectors), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(vectors[:, :3]).as_matrix()
    poses[:, :3, 3] = vectors[:, 3:]
    return poses
