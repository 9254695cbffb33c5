"""The paper's network as an estimator."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import check_image
from laploop.perception.estimators.network_loading import check_size, for_inference, load_network, shipped_weights
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.ssle_network import FORMAT, SsleConfig, SsleNetwork

SHIPPED_WEIGHTS = shipped_weights("ssle")

TRAINED_RANGE_MM = (40.0, 160.0)
"""Depths that training data hold; the network has no confidence, so that a depth inside is all that makes a pixel valid."""


class SsleEstimator:
    """Runs an `SsleNetwork` on one image at a time.

    The network says nothing of how sure it is, and the paper takes validity from the reference camera, which a running system
    does not have. Here a pixel is valid when its depth lies in the range that was trained, which flags little: whoever needs to
    know where an estimate can be trusted takes an estimator with a confidence.
    """

    def __init__(
        self,
        rig: Rig,
        network: SsleNetwork,
        *,
        range_mm: tuple[float, float] = TRAINED_RANGE_MM,
        device: str = "cpu",
    ) -> None:
        """Take over a network.

        Raises:
            InvalidValueError: If the network takes images of another size than the rig's, or the range is empty.
        """
        check_size(rig, network.config.height, network.config.width)
        if not 0.0 <= range_mm[0] < range_mm[1]:
            raise InvalidValueError("range_mm", range_mm, "0 mm or more, in rising order")
        self._rig, self._range_mm = rig, range_mm
        self._device = torch.device(device)
        self._network = for_inference(network, self._device)

    @classmethod
    def from_weights(cls, rig: Rig, weights: Path | None = None, *, device: str = "cpu") -> "SsleEstimator":
        """Load weights of any size, by default the shipped ones; the size is told by the file.

        Raises:
            MissingFileError: If the file is not there.
            WeightsError: If it is damaged, of another network, or not safetensors.
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        path = SHIPPED_WEIGHTS if weights is None else Path(weights)
        return cls(rig, load_network(path, FORMAT, SsleConfig, SsleNetwork), device=device)

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width).

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        check_image(image, self._rig)
        with torch.inference_mode():
            batch = torch.from_numpy(image.astype(np.float32))[None].to(self._device)
            depth_mm: NDArray[np.float32] = self._network(batch).depth_mm[0].cpu().numpy()
        return DepthEstimate(depth_mm=depth_mm, valid=(depth_mm >= self._range_mm[0]) & (depth_mm <= self._range_mm[1]))
