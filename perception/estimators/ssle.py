"""The paper's network as an estimator."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.estimators.base import check_image
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.ssle_network import FORMAT, SsleConfig, SsleNetwork
from laploop.perception.networks.stored_config import stored_config
from laploop.perception.weights import load_weights, read_architecture

SHIPPED_WEIGHTS = Path(str(files("laploop.assets") / "weights" / "ssle.safetensors"))
"""The weights that come with laploop; their card lies beside them."""

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
        size = (rig.camera.height, rig.camera.width)
        takes = (network.config.height, network.config.width)
        if takes != size:
            raise InvalidValueError("image (height, width) of the rig", size, f"{takes}, what these weights were trained for")
        if not 0.0 <= range_mm[0] < range_mm[1]:
            raise InvalidValueError("range_mm", range_mm, "0 mm or more, in rising order")
        self._rig, self._range_mm = rig, range_mm
        self._device = torch.device(device)
        self._network = network.eval().to(self._device).requires_grad_(requires_grad=False)
        self._network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @classmethod
    def from_weights(cls, rig: Rig, weights: Path | None = None, *, device: str = "cpu") -> "SsleEstimator":
        """Load weights of any size, by default the shipped ones; the size is told by the file.

        Raises:
            MissingFileError: If the file is not there.
            WeightsError: If it is damaged, of another network, or not safetensors.
            InvalidValueError: If the network takes images of another size than the rig's.
        """
        return cls(rig, load_ssle(SHIPPED_WEIGHTS if weights is None else Path(weights)), device=device)

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


def load_ssle(path: Path) -> SsleNetwork:
    """Build the network that a file describes, with the file's weights.

    Raises:
        MissingFileError: If the file is not there.
        WeightsError: If it is damaged, of another network, or not safetensors.
    """
    config = stored_config(SsleConfig, read_architecture(path, FORMAT), path)
    network = SsleNetwork(config)
    tensors, _ = load_weights(path, config.architecture, network.state_dict())
    network.load_state_dict(tensors)
    return network
