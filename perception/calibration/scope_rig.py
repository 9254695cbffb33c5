"""The rig of a calibrated scope, which estimators are made for, and the calibration of a scope as designed."""

import math
from pathlib import Path

import numpy as np

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, check_range
from laploop.perception.calibration.calibration_file import CalibrationRecord, save_calibration
from laploop.perception.calibration.projector import CalibratedRig, calibrated_rig, designed_projector
from laploop.perception.calibration.results import MIN_VIEWS, CameraCalibration
from laploop.perception.geometry import Rig
from laploop.perception.reprojection import BrownDistortion

_LEAST_BASELINE_M = 1e-4
"""As of a design; what a projector above or below the camera has beside it is less."""


def rig_of(record: CalibrationRecord, path: Path) -> CalibratedRig:
    """Return the parallel rig nearest to a calibrated scope; `path` is what messages call its file.

    Raises:
        InvalidValueError: If the projector was not calibrated, or stands where none can (`Rig` has it to the camera's right).
    """
    if record.projector is None:
        raise InvalidValueError("calibration", str(path), "one with a section projector, as `laploop calibrate` writes")
    camera = record.scope.intrinsics
    nominal = Rig(camera=camera, baseline_m=ScopeOptics().baseline_m, mask=record.mask or StripeMask())
    try:
        found = calibrated_rig(record.scope, record.projector, nominal)
        check_range("baseline_m", found.rig.baseline_m, _LEAST_BASELINE_M, 1.0)
    except InvalidValueError as error:
        raise InvalidValueError("calibration", str(path), f"one of a projector to the camera's right ({error})") from error
    return found


def optics_of(record: CalibrationRecord, path: Path) -> ScopeOptics:
    """Return the scope's optics nearest to a calibration, for what asks for a design; raises as `rig_of` does.

    A design has square pixels and a centred camera: the rig itself is that of `rig_of`.
    """
    rig = rig_of(record, path).rig
    camera = rig.camera
    try:
        return ScopeOptics(
            width=camera.width,
            height=camera.height,
            fov_rad=2.0 * math.atan(0.5 * camera.width / camera.fx),
            baseline_m=rig.baseline_m,
            mask=rig.mask,
        )
    except InvalidValueError as error:
        raise InvalidValueError("calibration", str(path), f"one of a scope's camera ({error})") from error


def save_design(path: Path, optics: ScopeOptics) -> None:
    """Write a scope as designed in the form of a calibration file; `rig_of` gives the nominal rig back to the bit.

    Raises:
        OutputError: If the file cannot be written.
    """
    rig = Rig.from_optics(optics)
    camera = CameraCalibration(
        intrinsics=rig.camera,
        distortion=BrownDistortion(),
        view_errors_px=(0.0,) * MIN_VIEWS,
        camera_from_board=np.tile(np.eye(4), (MIN_VIEWS, 1, 1)),
    )
    save_calibration(path, camera, projector=designed_projector(rig), mask=optics.mask)
