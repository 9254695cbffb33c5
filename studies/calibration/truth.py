"""True errors of a bench's calibration, which only a simulator knows, and its tables."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.perception.calibration.projector import ProjectorCalibration, phase_of_mask
from laploop.perception.calibration.results import CameraCalibration, transform_residual
from laploop.perception.geometry import Intrinsics, Rig
from laploop.studies.calibration.hand_eye_views import flange_from_camera
from laploop.studies.calibration.run import BenchCalibration
from laploop.studies.csv_text import csv_text

Array = NDArray[np.float64]

_BIAS_DEPTH_M = 0.1


@dataclass(frozen=True, kw_only=True)
class TransformResidual:
    """Error of a rigid transform."""

    rotation_deg: float
    translation_mm: float


@dataclass(frozen=True, kw_only=True)
class IntrinsicsResidual:
    """Calibrated minus true, pixels."""

    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def of(cls, found: CameraCalibration, true: Intrinsics) -> "IntrinsicsResidual":
        """Compare a calibration with the truth."""
        return cls(**{name: getattr(found.intrinsics, name) - getattr(true, name) for name in ("fx", "fy", "cx", "cy")})


@dataclass(frozen=True, kw_only=True)
class ProjectorResidual:
    """Calibrated minus true."""

    baseline_um: float
    ahead_um: float
    """Of the projector's centre along the camera's axis."""
    pitch_deg: float
    yaw_deg: float
    roll_deg: float
    period_ppm: float
    phase_turns: float
    """On the projector's axis. It nearly cancels the yaw: both shift all stripes."""
    depth_bias_mm: float
    """Mean depth error on a plane at 100 mm, from exact stripes with the calibrated camera and projector."""
    depth_rms_mm: float
    rig_depth_bias_mm: float
    """The same with the parallel rig fitted to the calibration."""
    rig_depth_rms_mm: float


@dataclass(frozen=True, kw_only=True)
class TrueResiduals:
    """Errors of everything that was calibrated."""

    stereo: TransformResidual
    scope: IntrinsicsResidual
    reference: IntrinsicsResidual
    projector: ProjectorResidual | None
    hand_eye: TransformResidual | None


def true_residuals(found: BenchCalibration) -> TrueResiduals:
    """Compare a calibration with the bench it was made on."""
    bench, stereo = found.config.bench, found.stereo
    hand_eye = None
    if found.hand_eye is not None:
        true = flange_from_camera(bench.scope.baseline_m)
        hand_eye = _transform_residual(found.hand_eye.flange_from_camera, true)
    return TrueResiduals(
        stereo=_transform_residual(stereo.scope_from_reference, bench.scope_from_reference),
        scope=IntrinsicsResidual.of(stereo.scope, bench.rig.camera),
        reference=IntrinsicsResidual.of(stereo.reference, bench.reference.intrinsics),
        projector=None if found.projector is None else _projector_residual(found, found.projector),
        hand_eye=hand_eye,
    )


def as_dict(found: BenchCalibration) -> dict[str, object]:
    """Return the numbers of the summary."""
    stereo, joint = found.stereo, found.joint
    return {
        "reprojection_error_px": {
            "scope": joint.scope_error_px,
            "reference": joint.reference_error_px,
            "reference_factory": stereo.reference.error_px,
            "pairs": stereo.error_px,
            "hand_eye": None if found.hand_eye is None else found.hand_eye.error_px,
        },
        "projector_error_turns": None if found.projector is None else found.projector.error_turns,
        "projector_deviations": None if found.projector is None else dict(found.projector.deviations),
        "rig": None
        if found.rig is None
        else {
            "baseline_m": found.rig.rig.baseline_m,
            "period_tan": found.rig.rig.mask.period_tan,
            "phase": found.rig.rig.mask.phase,
            "misfit_turns": found.rig.misfit_turns,
            "misfit_mm": found.rig.misfit_mm,
            "distortion_px": found.rig.distortion_px,
        },
        "true_residual": true_residuals(found),
    }


def corners_as_csv(found: BenchCalibration) -> str:
    """Return a row for each corner of each picture: measured minus reprojected, pixels."""
    rows = (
        (step, camera, view, corner, *(f"{shift:.4f}" for shift in misfit[view, corner]))
        for step, camera, misfit in misfits(found)
        for view, corner in np.ndindex(*misfit.shape[:2])
    )
    return csv_text(("step", "camera", "view", "corner", "du_px", "dv_px"), rows)


def views_as_csv(found: BenchCalibration) -> str:
    """Return a row for each picture with its root mean square reprojection error."""
    rows: list[tuple[object, ...]] = []
    for step, camera, misfit in misfits(found):
        errors = np.sqrt((misfit**2).sum(axis=-1).mean(axis=-1))
        rows += [(step, camera, view, f"{error:.4f}", "px") for view, error in enumerate(errors)]
    rows += [("factory", "reference", view, f"{e:.4f}", "px") for view, e in enumerate(found.stereo.reference.view_errors_px)]
    if found.projector is not None:
        rows += [("card", "scope", view, f"{e:.5f}", "turns") for view, e in enumerate(found.projector.view_errors_turns)]
    if found.hand_eye is not None:
        rows += [("arm", "scope", view, f"{e:.4f}", "px") for view, e in enumerate(found.hand_eye.view_errors_px)]
    return csv_text(("step", "camera", "view", "error", "unit"), rows)


def misfits(found: BenchCalibration) -> tuple[tuple[str, str, Array], ...]:
    """Return step, camera and misfit (views, corners, 2) of the pictures in the joint adjustment."""
    joint = found.joint
    return (
        ("own", "scope", joint.own_misfit_px),
        ("pair", "scope", joint.scope_misfit_px),
        ("pair", "reference", joint.reference_misfit_px),
    )


def _transform_residual(found: Array, true: Array) -> TransformResidual:
    degrees, mm = transform_residual(found, true)
    return TransformResidual(rotation_deg=degrees, translation_mm=mm)


def _projector_residual(found: BenchCalibration, projector: ProjectorCalibration) -> ProjectorResidual:
    nominal, camera = found.config.bench.rig, found.stereo.scope
    true_from_camera = nominal.projector_from_camera
    centre = -true_from_camera[:3, :3].T @ true_from_camera[:3, 3]
    turned = projector.projector_from_camera[:3, :3] @ true_from_camera[:3, :3].T
    pitch, yaw, roll = Rotation.from_matrix(turned).as_euler("xyz", degrees=True)
    phase = projector.phase_turns - phase_of_mask(nominal.mask)
    by_projector = _depth_errors(nominal, camera, projector, None)
    by_rig = _depth_errors(nominal, camera, projector, None if found.rig is None else found.rig.rig)
    return ProjectorResidual(
        baseline_um=1e6 * (projector.baseline_m - float(centre[0])),
        ahead_um=1e6 * float(projector.centre_m[2] - centre[2]),
        pitch_deg=float(pitch),
        yaw_deg=float(yaw),
        roll_deg=float(roll),
        period_ppm=1e6 * (projector.period_tan / nominal.mask.period_tan - 1.0),
        phase_turns=phase - round(phase),
        depth_bias_mm=float(by_projector.mean()),
        depth_rms_mm=float(np.sqrt((by_projector**2).mean())),
        rig_depth_bias_mm=float(by_rig.mean()),
        rig_depth_rms_mm=float(np.sqrt((by_rig**2).mean())),
    )


def _depth_errors(nominal: Rig, camera: CameraCalibration, projector: ProjectorCalibration, rig: Rig | None) -> Array:
    """Return the errors in mm, where a plane at 100 mm is lit, of depths triangulated from its exact stripes."""
    mask = nominal.mask
    depth = np.full(nominal.camera.rays.shape[:2], _BIAS_DEPTH_M)
    x = nominal.projector_x(depth)
    lit = np.abs(x) < mask.half_width_tan
    turns = x / mask.period_tan + phase_of_mask(mask)
    rays = camera.undistorted_rays()
    # Whole turns are the estimator's task: they are taken from the truth here.
    if rig is None:
        expected = projector.turns(rays * _BIAS_DEPTH_M)
        found = projector.depth_from_turns(rays, turns + np.round(expected - turns))
    else:
        phase = phase_of_mask(rig.mask)
        expected = rig.projector_x(depth) / rig.mask.period_tan + phase
        found = rig.depth_from_projector_x((turns + np.round(expected - turns) - phase) * rig.mask.period_tan)
    errors: Array = 1e3 * (found - _BIAS_DEPTH_M)[lit]
    return errors[np.isfinite(errors)] if errors.size else np.array([math.nan])
