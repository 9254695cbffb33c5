"""What blur alone costs: the error of exact depth, blurred.

`python -P -m laploop.studies.depth.blurred_truth FILE FOLDER/frames.zarr...` measures it on the test frames of data sets and
writes FILE, JSON. It is a yardstick for the errors of networks and no bound on them: a reader that keeps edges sharp is better
than any blur.
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import AnyStore, open_dataset
from laploop.perception.working_range import WORKING_RANGE_MM
from laploop.whole_file import whole_file

SIGMAS_PX = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""Standard deviations of the blur."""


def blurred(depth_mm: NDArray[np.floating], sigma_px: float) -> NDArray[np.float64]:
    """Return a depth map (H, W) averaged with a Gaussian over what is known of it; NaN is not known, and stays NaN."""
    known = np.isfinite(depth_mm)
    total = gaussian_filter(np.where(known, depth_mm, 0.0).astype(np.float64), sigma_px)
    weight = gaussian_filter(known.astype(np.float64), sigma_px)
    return np.asarray(np.divide(total, weight, out=np.full(depth_mm.shape, np.nan), where=known))


def measure_blur(data: AnyStore) -> dict[str, Any]:
    """Return what each blur costs on the lit pixels in the working range of a data set's test frames.

    Returns:
        `frames`, and `mae_mm` for each of `SIGMAS_PX`.

    Raises:
        InvalidValueError: If there is no test frame, or none with a lit pixel in the range.
    """
    nearest, farthest = WORKING_RANGE_MM
    indices = data.indices("test")
    errors, pixels = np.zeros(len(SIGMAS_PX)), 0
    for index in indices.tolist():
        depth_mm = data.depth_mm(index)
        counted = (depth_mm >= nearest) & (depth_mm <= farthest) & data.lit(index)
        pixels += int(counted.sum())
        errors += [np.abs(blurred(depth_mm, sigma)[counted] - depth_mm[counted]).sum() for sigma in SIGMAS_PX]
    if pixels == 0:
        raise InvalidValueError("lit pixels of the test frames", 0, "1 or more in the working range")
    return {"frames": len(indices), "mae_mm": (errors / pixels).tolist()}


def main(arguments: Sequence[str]) -> None:
    """Measure, and write the file that is given first; data sets go by the names of their folders."""
    file, *stores = map(Path, arguments)
    sets = {store.parent.name: measure_blur(open_dataset(store)) for store in stores}
    result = {"sigma_px": list(SIGMAS_PX), "sets": sets}
    with whole_file(file) as partial:
        partial.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
