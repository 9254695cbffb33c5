"""Files of a prediction, for programs that know nothing of this one.

| file | what |
|---|---|
| `NAME_depth.png` | 16 bits, z-depth in units of 0.01 mm; 0 where invalid or beyond 655.35 mm |
| `NAME_depth.npy` | (H, W) float32, z-depth in millimetres, NaN where invalid |
| `NAME_raw.npy` | (H, W) float32, z-depth in millimetres everywhere, valid or not |
| `NAME_confidence.png`, `.npy` | probability of being within 1 mm: 8 bits (255 is 1) and float32; where the estimator has one |
| `NAME_slip.png`, `.npy` | probability of a slip, as the confidence; where the estimator has one |
| `NAME_cloud.ply` | binary; the valid pixels' points in the camera's frame in millimetres, coloured by their grey values |
| `NAME_overlay.png` | depth in colours over the picture |

All of the undistorted picture: a pinhole camera with the intrinsics of the calibration.
"""

import io
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.perception.geometry import Intrinsics
from laploop.perception.pictures.overlay import draw_overlay
from laploop.perception.pictures.predictor import PicturePrediction

DEPTH_UNIT_MM = 0.01
"""Of one grey value of a depth picture."""


def prediction_files(name: str, prediction: PicturePrediction, camera: Intrinsics) -> dict[str, bytes]:
    """Return the files of a prediction by name; `camera` took the picture."""
    depth_mm, valid = prediction.depth_mm, prediction.valid
    files = {
        f"{name}_depth.png": png_bytes(depth_picture(depth_mm)),
        f"{name}_depth.npy": _npy_bytes(depth_mm),
        f"{name}_raw.npy": _npy_bytes(prediction.raw_depth_mm),
        f"{name}_cloud.ply": cloud_bytes(prediction.image, depth_mm, valid, camera),
        f"{name}_overlay.png": png_bytes(draw_overlay(prediction.image, depth_mm)),
    }
    for what, probability in (("confidence", prediction.confidence), ("slip", prediction.slip)):
        if probability is not None:
            files[f"{name}_{what}.npy"] = _npy_bytes(probability)
            files[f"{name}_{what}.png"] = png_bytes(np.round(255.0 * probability).astype(np.uint8))
    return files


def depth_picture(depth_mm: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return depth (H, W), NaN where invalid, in units of `DEPTH_UNIT_MM`; 0 where invalid or beyond what 16 bits hold."""
    units = np.round(depth_mm.astype(np.float64) / DEPTH_UNIT_MM)
    # NaN fails the comparison.
    fits = (units >= 1.0) & (units <= np.iinfo(np.uint16).max)
    return np.where(fits, units, 0.0).astype(np.uint16)


def cloud_bytes(image: NDArray[np.uint8], depth_mm: NDArray[np.float32], valid: NDArray[np.bool_], camera: Intrinsics) -> bytes:
    """Return the valid pixels as a binary PLY, points in millimetres in the camera's frame, coloured by grey value."""
    from trimesh import PointCloud  # slow to import

    # trimesh cannot write nothing: without a valid pixel one point is written, and taken out again.
    shown = valid if valid.any() else np.arange(valid.size).reshape(valid.shape) == 0
    points = camera.rays[shown] * depth_mm[shown, None].astype(np.float64)
    grey = image[shown]
    colours = np.stack([grey, grey, grey, np.full_like(grey, 255)], axis=-1)
    cloud: Any = PointCloud
    content = cloud(points, colors=colours).export(file_type="ply")
    if valid.any():
        return bytes(content)
    header, end, _ = bytes(content).partition(b"end_header\n")
    return header.replace(b"element vertex 1\n", b"element vertex 0\n") + end


def png_bytes(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Return a picture as PNG; colours are blue, green, red, as OpenCV has them."""
    return cv2.imencode(".png", picture)[1].tobytes()


def _npy_bytes(values: NDArray[np.float32]) -> bytes:
    content = io.BytesIO()
    np.save(content, values, allow_pickle=False)
    return content.getvalue()
