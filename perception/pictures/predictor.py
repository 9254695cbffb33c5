"""Depth of pictures that a calibrated scope took, by any estimator that loops can close on."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.calibration.calibration_file import load_record
from laploop.perception.calibration.projector import CalibratedRig
from laploop.perception.calibration.scope_rig import rig_of
from laploop.perception.estimators.base import DepthEstimator, checked_estimate
from laploop.perception.estimators.registry import BASELINES, ESTIMATORS, make_estimator
from laploop.perception.network_specs import NetworkSpec
from laploop.perception.pictures.undistortion import Undistortion
from laploop.perception.stripe_check import StripeCheck, StripePresence

NO_STRIPES = "no stripes of the calibrated pitch; all pixels are invalid"


@dataclass(frozen=True, kw_only=True, eq=False)
class PicturePrediction:
    """What was made of one picture; all arrays are (height, width), of the pinhole camera of the calibration."""

    image: NDArray[np.uint8]
    """The picture, undistorted."""
    raw_depth_mm: NDArray[np.float32]
    """The estimator's z-depth everywhere, valid or not."""
    valid: NDArray[np.bool_]
    """Where the estimator marks its depth valid, the picture shows stripes, and the lens reaches."""
    confidence: NDArray[np.float32] | None
    """Probability of being within 1 mm, 0 where invalid; None where the estimator has none."""
    slip: NDArray[np.float32] | None
    """Probability of a slip, 1 where there is nothing to be read: no stripes, or beyond the lens; None where the estimator has
    none."""
    stripes: StripePresence
    estimate_ms: float
    """Time of the estimate alone."""

    @property
    def depth_mm(self) -> NDArray[np.float32]:
        """Depth where it is valid, NaN elsewhere."""
        return np.where(self.valid, self.raw_depth_mm, np.float32(np.nan))

    @property
    def note(self) -> str:
        """What the user should know of this picture."""
        return "" if self.stripes.present else NO_STRIPES


class PicturePredictor:
    """An estimator made for a calibrated scope, with what a picture needs before and after it."""

    def __init__(self, calibration: Path, model: str, weights: Path | None = None) -> None:
        """Read a calibration file and make the estimator.

        Raises:
            MissingFileError: If the calibration or the weights are not there.
            UnknownNameError: If nobody registered the model.
            InvalidValueError: If the calibration is not valid or has no projector, its mask is drawn and the model a network,
                or the model needs the truth or gives no metric depth.
            WeightsError: If the weights are damaged or of another network.
        """
        _check_model(model)
        record = load_record(calibration)
        self.calibrated: CalibratedRig = rig_of(record, calibration)
        self.rig = self.calibrated.rig
        if self.rig.mask.is_drawn and model in ESTIMATORS.names() and isinstance(ESTIMATORS.get(model), NetworkSpec):
            allowed = f"one with stripes for the network {model}; a drawn mask is read by phase or an estimator of your own"
            raise InvalidValueError("mask of the calibration", str(calibration), allowed)
        self._undistortion = Undistortion(record.scope)
        self._check = StripeCheck(self.rig)
        self._estimator: DepthEstimator = make_estimator(model, self.rig, weights)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the pictures."""
        return self.rig.camera.height, self.rig.camera.width

    def predict(self, picture: NDArray[np.uint8]) -> PicturePrediction:
        """Estimate depth in a picture (height, width) as the camera gave it."""
        image = self._undistortion.apply(picture)
        stripes = self._check.find(image)
        began = time.perf_counter()
        estimate = checked_estimate(self._estimator.estimate(image), image.shape)
        estimate_ms = 1e3 * (time.perf_counter() - began)
        readable = self._undistortion.seen & stripes.present
        valid = estimate.valid & readable
        confidence = None if estimate.confidence is None else np.where(valid, estimate.confidence, np.float32(0.0))
        slip = None if estimate.slip is None else np.where(readable, estimate.slip, np.float32(1.0))
        return PicturePrediction(
            image=image,
            raw_depth_mm=estimate.depth_mm,
            valid=valid,
            confidence=confidence,
            slip=slip,
            stripes=stripes,
            estimate_ms=estimate_ms,
        )


def _check_model(model: str) -> None:
    if model == "oracle" or model in BASELINES.names():
        names = ", ".join(name for name in ESTIMATORS.names() if name != "oracle")
        raise InvalidValueError("model", model, f"one that gives metric depth of a picture alone: {names}, or module:Class")
    ESTIMATORS.check(model)
