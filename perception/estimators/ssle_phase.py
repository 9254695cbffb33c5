"""`ssle-phase` as an estimator: any regular stripe mask, baseline and field of view; the rig is an input of the network."""

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.estimators.base import check_image
from laploop.perception.estimators.freed_memory import keep_freed_memory
from laploop.perception.estimators.network_loading import check_size, for_inference, shipped_weights
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.ssle_phase import SslePhase, SslePhaseConfig
from laploop.perception.networks.ssle_phase_front import RigBatch
from laploop.perception.weights import load_weights

SHIPPED_WEIGHTS = shipped_weights("ssle-phase")


class SslePhaseEstimator:
    """Runs an `SslePhase` on one image at a time and calls valid what the network says it knows."""

    def __init__(self, rig: Rig, network: SslePhase, *, max_scale_mm: float = 2.0, device: str = "cpu") -> None:
        """Take over a network, which is put into inference form.

        A pixel is valid when its predicted Laplace scale is at most `max_scale_mm`.

        Raises:
            InvalidValueError: If `max_scale_mm` is not above 0, the image is not of the network's size, or the mask is drawn
                by an image.
        """
        if not max_scale_mm > 0.0:
            raise InvalidValueError("max_scale_mm", max_scale_mm, "above 0 mm")
        check_size(rig, network.config.height, network.config.width)
        rigs = RigBatch.from_rigs([rig])
        keep_freed_memory()
        self._rig = rig
        self._max_scale_mm = np.float32(max_scale_mm)
        self._device = torch.device(device)
        self._network = for_inference(network, self._device)
        self._filters = self._network.prepare(RigBatch(values=rigs.values.to(self._device)))

    @classmethod
    def from_weights(
        cls, rig: Rig, weights: Path | None = None, *, max_scale_mm: float = 2.0, device: str = "cpu"
    ) -> "SslePhaseEstimator":
        """Load weights, by default the shipped ones.

        Raises:
            MissingFileError: If the file is not there.
            WeightsError: If it is damaged, of another architecture, or not safetensors.
        """
        path = SHIPPED_WEIGHTS if weights is None else Path(weights)
        if not path.is_file():
            raise MissingFileError("weights", path, "train them with `laploop train --model ssle-phase`, or give another path")
        config = SslePhaseConfig()
        network = SslePhase(config)
        tensors, _ = load_weights(path, config.architecture, network.state_dict())
        network.load_state_dict(tensors)
        return cls(rig, network, max_scale_mm=max_scale_mm, device=device)

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width).

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        depth_mm, scale_mm = self.estimate_with_scale(image)
        return DepthEstimate(depth_mm=depth_mm, valid=scale_mm <= self._max_scale_mm)

    def estimate_with_scale(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return depth and its predicted Laplace scale, both (height, width) in millimetres.

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        check_image(image, self._rig)
        with torch.inference_mode():
            batch = torch.from_numpy(image.astype(np.float32))[None].to(self._device)
            output = self._network(batch, self._filters)
            depth_mm: NDArray[np.float32] = output.depth_mm[0].cpu().numpy()
            scale_mm: NDArray[np.float32] = output.log_scale[0].exp().cpu().numpy()
        return depth_mm, scale_mm
