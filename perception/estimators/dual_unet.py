"""The prior method, MaskNet times DepthNet, as an estimator."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.perception.estimators.base import check_image
from laploop.perception.estimators.network_loading import check_size, for_inference, load_network, shipped_weights
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.dual_unet import FORMAT, DualUNet, DualUNetConfig

SHIPPED_WEIGHTS = shipped_weights("dual-unet")


class DualUNetEstimator:
    """Runs a `DualUNet` on one image at a time; valid is where MaskNet gives tissue a probability above one half."""

    def __init__(self, rig: Rig, network: DualUNet, *, device: str = "cpu") -> None:
        """Take over a network.

        Raises:
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        check_size(rig, network.config.height, network.config.width)
        self._rig = rig
        self._device = torch.device(device)
        self._network = for_inference(network, self._device)

    @classmethod
    def from_weights(cls, rig: Rig, weights: Path | None = None, *, device: str = "cpu") -> "DualUNetEstimator":
        """Load weights of any size, by default the shipped ones; the size is told by the file.

        Raises:
            MissingFileError: If the file is not there.
            WeightsError: If it is damaged, of another network, or not safetensors.
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        path = SHIPPED_WEIGHTS if weights is None else Path(weights)
        return cls(rig, load_network(path, FORMAT, DualUNetConfig, DualUNet), device=device)

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width).

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        check_image(image, self._rig)
        with torch.inference_mode():
            output = self._network(torch.from_numpy(image.astype(np.float32))[None].to(self._device))
            depth_mm: NDArray[np.float32] = output.depth_mm[0].cpu().numpy()
            valid: NDArray[np.bool_] = (output.mask_logit[0] > 0.0).cpu().numpy()
        return DepthEstimate(depth_mm=depth_mm, valid=valid)
