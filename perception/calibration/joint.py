"""One bundle adjustment of two cameras: the scope's intrinsics and the transform between the cameras, from all views at once.

A principal point that is wrong by a third of a pixel turns the view of a short lens by a tenth of a degree. A plane at one
distance hardly shows that, yet it moves a camera 0.6 m away by a millimetre. Calibrated separately, the scope's intrinsics
carry such an error into the transform. Here the pairs of views, whose boards the reference camera locates far better than the
scope does, constrain the scope's intrinsics as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from laploop.assets.calibration_board import CalibrationBoard
from laploop.errors import InvalidValueError
from laploop.perception.calibration.poses import place_board, pose_as_vector, vectors_as_poses
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration, check_view_count
from laploop.perception.calibration.solve import COEFFICIENTS, checked_corners
from laploop.perception.geometry import invert_transform

Array = NDArray[np.float64]

_INTRINSICS = ("fx", "fy", "cx", "cy")
_MIN_SIGMA_PX = 1e-6
"""Lets exact corners be weighted too."""
_STEP = 1e-6
"""Of the finite differences; all unknowns but those in pixels are of the order of 0.01 to 1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointCalibration:
    """A stereo calibration with the misfit of every corner: measured minus reprojected, pixels."""

    stereo: StereoCalibration
    scope_from_board: Array
    """(pairs, 4, 4), pose of the board in each pair of views."""
    own_misfit_px: Array
    """(views, corners, 2), of the scope's own views."""
    scope_misfit_px: Array
    """(pairs, corners, 2), of the scope's pictures of the pairs."""
    reference_misfit_px: Array
    """(pairs, corners, 2), of the reference camera's."""

    @property
    def scope_error_px(self) -> float:
        """Root mean square distance between corners and reprojections in the scope's pictures, own and of the pairs."""
        squares = [(misfit**2).sum(axis=-1).ravel() for misfit in (self.own_misfit_px, self.scope_misfit_px)]
        return float(np.sqrt(np.concatenate(squares).mean()))

    @property
    def reference_error_px(self) -> float:
        """The same in the reference camera's pictures of the pairs."""
        return float(np.sqrt((self.reference_misfit_px**2).sum(axis=-1).mean()))


def calibrate_jointly(
    own_views: Sequence[Array],
    scope_views: Sequence[Array],
    reference_views: Sequence[Array],
    board: CalibrationBoard,
    *,
    scope: CameraCalibration,
    reference: CameraCalibration,
) -> JointCalibration:
    """Refine the scope's intrinsics and the transform between the cameras on all views of both.

    Unknowns are the scope's focal lengths and principal point, the distortion coefficients that `scope` has, the transform, and
    the board's poses. The reference camera's intrinsics are kept, since its maker knows them better. Misfits are weighted by
    their root mean square in each camera, from a first pass.

    Args:
        own_views: The board's corners in the pictures that `scope` was calibrated from, (n, 2) each.
        scope_views: The same in the scope's pictures of the pairs.
        reference_views: The same in the reference camera's.
        board: The board in all these pictures.
        scope: The scope's camera, calibrated from `own_views`.
        reference: The reference camera.

    Raises:
        InvalidValueError: If there are too few views, different numbers of both, or corners are missing.
    """
    check_view_count(len(own_views))
    if len(own_views) != len(scope.camera_from_board):
        allowed = f"{len(scope.camera_from_board)}, those the scope was calibrated from"
        raise InvalidValueError("number of the scope's own views", len(own_views), allowed)
    check_view_count(len(scope_views))
    if len(reference_views) != len(scope_views):
        allowed = f"{len(scope_views)}, as many as of the scope"
        raise InvalidValueError("number of the reference camera's views", len(reference_views), allowed)
    own, in_scope, in_reference = (
        np.array([checked_corners(view, board) for view in views]) for views in (own_views, scope_views, reference_views)
    )
    problem = _Problem(board, own, in_scope, in_reference, scope, reference)
    unknowns = problem.start()
    sigmas = (1.0, 1.0)
    for _ in range(2):
        unknowns = problem.solve(unknowns, sigmas)
        *of_scope, of_reference = problem.misfits(unknowns)
        sigmas = (
            max(_MIN_SIGMA_PX, float(np.concatenate(of_scope, axis=None).std())),
            max(_MIN_SIGMA_PX, float(of_reference.std())),
        )
    return problem.result(unknowns)


class _Problem:
    """The unknowns as a vector: intrinsics, coefficients, then rotation vector and translation of transform and poses."""

    def __init__(
        self,
        board: CalibrationBoard,
        own: Array,
        in_scope: Array,
        in_reference: Array,
        scope: CameraCalibration,
        reference: CameraCalibration,
    ) -> None:
        self._points = board.corners
        self._measured = (own, in_scope, in_reference)
        self._scope = scope
        self._reference = reference
        self._free = tuple(name for name in COEFFICIENTS if getattr(scope.distortion, name) != 0.0)
        self._shared = len(_INTRINSICS) + len(self._free) + 6

    def start(self) -> Array:
        """Return the initial vector: poses from each camera alone, the transform from the pair of views that fits best."""
        values = [getattr(self._scope.intrinsics, name) for name in _INTRINSICS]
        values += [getattr(self._scope.distortion, name) for name in self._free]
        of_scope, of_reference = (
            np.array([place_board(camera, view, self._points) for view in views])
            for camera, views in ((self._scope, self._measured[1]), (self._reference, self._measured[2]))
        )

        def vector(scope_from_reference: Array) -> Array:
            poses = [scope_from_reference, *self._scope.camera_from_board, *of_reference]
            return np.concatenate([values, *(pose_as_vector(pose) for pose in poses)])

        candidates = [vector(one @ invert_transform(other)) for one, other in zip(of_scope, of_reference, strict=True)]
        return min(candidates, key=lambda unknowns: float((self.misfits(unknowns)[1] ** 2).sum()))

    def solve(self, unknowns: Array, sigmas: tuple[float, float]) -> Array:
        """Minimise the weighted misfit."""
        weights = np.concatenate([
            np.full(misfit.size, 1.0 / sigma)
            for misfit, sigma in zip(self._measured, (sigmas[0], sigmas[0], sigmas[1]), strict=True)
        ])  # fmt: skip

        def misfit(values: Array) -> Array:
            weighted: Array = weights * np.concatenate([part.ravel() for part in self.misfits(values)])
            return weighted

        def jacobian(values: Array) -> Array:
            return self._jacobian(misfit, values)

        # MINPACK does without BLAS, whose last digits depend on its number of threads.
        found: Any = least_squares(misfit, unknowns, jac=jacobian, x_scale="jac", method="lm", xtol=1e-12, ftol=1e-12)
        return np.asarray(found.x)

    def misfits(self, unknowns: Array) -> tuple[Array, Array, Array]:
        """Return measured minus reprojected corners: own views, then the scope's and the reference camera's of the pairs."""
        own, in_scope, in_reference = self._measured
        scope = self._scope_of(unknowns)
        poses = vectors_as_poses(unknowns[self._shared - 6 :].reshape(-1, 6))
        own_poses, pair_poses = poses[1 : 1 + len(own)], poses[1 + len(own) :]
        return (
            own - scope.project(self._placed(own_poses)),
            in_scope - scope.project(self._placed(poses[0] @ pair_poses)),
            in_reference - self._reference.project(self._placed(pair_poses)),
        )

    def result(self, unknowns: Array) -> JointCalibration:
        """Return the calibration that a vector stands for."""
        misfits = self.misfits(unknowns)
        poses = vectors_as_poses(unknowns[self._shared - 6 :].reshape(-1, 6))
        views = len(misfits[0])
        scope = replace(self._scope_of(unknowns), view_errors_px=_errors(misfits[0]), camera_from_board=poses[1 : 1 + views])
        pair_errors = [0.5 * (m**2).sum(axis=-1).mean(axis=-1) for m in misfits[1:]]
        stereo = StereoCalibration(
            scope=scope,
            reference=self._reference,
            scope_from_reference=poses[0],
            view_errors_px=tuple(float(error) for error in np.sqrt(pair_errors[0] + pair_errors[1])),
        )
        return JointCalibration(
            stereo=stereo,
            scope_from_board=poses[0] @ poses[1 + views :],
            own_misfit_px=misfits[0],
            scope_misfit_px=misfits[1],
            reference_misfit_px=misfits[2],
        )

    def _scope_of(self, unknowns: Array) -> CameraCalibration:
        numbers = dict(zip((*_INTRINSICS, *self._free), (float(v) for v in unknowns), strict=False))
        fx, fy, cx, cy = (numbers[name] for name in _INTRINSICS)
        intrinsics = replace(self._scope.intrinsics, fx=fx, fy=fy, cx=cx, cy=cy)
        distortion = replace(self._scope.distortion, **{name: numbers[name] for name in self._free})
        return replace(self._scope, intrinsics=intrinsics, distortion=distortion)

    def _placed(self, poses: Array) -> Array:
        """Return the corners (views, n, 3) of boards in some poses (views, 4, 4)."""
        placed: Array = self._points @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
        return placed

    def _jacobian(self, misfit: Callable[[Array], Array], unknowns: Array) -> Array:
        """Differentiate by differences; a pose affects its own view alone, so that all poses are stepped at once."""
        here = misfit(unknowns)
        jacobian = np.zeros((len(here), len(unknowns)))
        for column in range(self._shared):
            moved = unknowns.copy()
            moved[column] += _STEP
            jacobian[:, column] = (misfit(moved) - here) / _STEP
        views, pairs = len(self._measured[0]), len(self._measured[1])
        size = 2 * len(self._points)
        for number in range(6):
            moved = unknowns.copy()
            moved[self._shared + number :: 6] += _STEP
            slopes = ((misfit(moved) - here) / _STEP).reshape(-1, size)
            for view in range(views + 2 * pairs):
                pose = view if view < views + pairs else view - pairs
                jacobian[view * size : (view + 1) * size, self._shared + 6 * pose + number] = slopes[view]
        return jacobian


def _errors(misfit: Array) -> tuple[float, ...]:
    return tuple(float(error) for error in np.sqrt((misfit**2).sum(axis=-1).mean(axis=-1)))
