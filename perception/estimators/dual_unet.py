"""The prior method, MaskNet times DepthNet, as an estimator."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import check_image
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.dual_unet import FORMAT, DualUNet, DualUNetConfig
from laploop.perception.networks.stored_config import stored_config
from laploop.perception.weights import load_weights, read_architecture

SHIPPED_WEIGHTS = Path(str(files("laploop.assets") / "weights" / "dual-unet.safetensors"))
"""The weights that come with laploop; their card lies beside them."""


class DualUNetEstimator:
    """Runs a `DualUNet` on one image at a time; valid is where MaskNet gives tissue a probability above one half."""

    def __init__(self, rig: Rig, network: DualUNet, *, device: str = "cpu") -> None:
        """Take over a network.

        Raises:
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        size = (rig.camera.height, rig.camera.width)
        takes = (network.config.height, network.config.width)
        if takes != size:
            raise InvalidValueError("image (height, width) of the rig", size, f"{takes}, what these weights were trained for")
        self._rig = rig
        self._device = torch.device(device)
        self._network = network.eval().to(self._device).requires_grad_(requires_grad=False)
        self._network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @classmethod
    def from_weights(cls, rig: Rig, weights: Path | None = None, *, device: str = "cpu") -> "DualUNetEstimator":
        """Load weights of any size, by default the shipped ones; the size is told by the file.

        Raises:
            MissingFileError: If the file is not there.
            WeightsError: If it is damaged, of another network, or not safetensors.
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        return cls(rig, load_dual_unet(SHIPPED_WEIGHTS if weights is None else Path(weights)), device=device)

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


def load_dual_unet(path: Path) -> DualUNet:
    """Build the network that a file describes, with the file's weights.

    Raises:
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
    """
    config = stored_config(DualUNetConfig, read_architecture(path, FORMAT), path)
    network = DualUNet(config)
    tensors, _ = load_weights(path, config.architecture, network.state_dict())
    network.load_state_dict(tensors)
    return network
