"""Depth networks as estimators; which pixels are valid depends on what the network predicts beside the depth."""

import math
from abc import ABC, abstractmethod
from typing import Any, Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from laploop.errors import InvalidValueError, check_range
from laploop.perception.estimators.base import check_image
from laploop.perception.estimators.freed_memory import keep_freed_memory
from laploop.perception.geometry import Rig
from laploop.perception.inference.depth_module import fold_batch_norms, lower_precision
from laploop.perception.inference.torch_runner import check_device, has_fast_bf16
from laploop.perception.messages import DepthEstimate
from laploop.perception.networks.depth_network import DepthNetwork
from laploop.perception.working_range import WORKING_RANGE_MM

Precision = Literal["auto", "fp32", "bf16"]
"""What the network is computed in."""


class NetworkEstimator(ABC):
    """Runs a depth network on one image at a time."""

    def __init__(self, rig: Rig, network: DepthNetwork, *, device: str = "cpu", precision: Precision = "auto") -> None:
        """Take over a network, which is put into inference form: normalisations folded, channels last, no gradients.

        Args:
            rig: The rig whose images it will see.
            network: The network.
            device: cpu, cuda, or cuda:N.
            precision: fp32, bf16 (all convolutions but the last), or auto: bf16 where the network tolerates it and the CPU
                computes it in hardware, fp32 otherwise.

        Raises:
            InvalidValueError: If this machine does not have the device, or there is no such precision.
        """
        check_device(device)
        if precision not in get_args(Precision):
            raise InvalidValueError("precision", precision, ", ".join(get_args(Precision)))
        keep_freed_memory()
        self._rig = rig
        self._device = torch.device(device)
        self._network: Any = network.eval().requires_grad_(requires_grad=False)
        fold_batch_norms(network)
        network.to(self._device)
        # The filters of a rig are computed on the device, with its arithmetic.
        context = network.context(rig)
        self._context = () if context is None else (context,)
        if precision == "auto":
            precision = "bf16" if device == "cpu" and network.tolerates_bf16 and has_fast_bf16() else "fp32"
        self.precision = precision
        if precision == "bf16":
            lower_precision(network)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres and its validity from an image (height, width); see `DepthEstimator`."""
        check_image(image, self._rig)
        lowered = torch.autocast(self._device.type, torch.bfloat16, enabled=self.precision == "bf16", cache_enabled=False)
        with torch.inference_mode(), lowered:
            output = self._network(torch.from_numpy(image.astype(np.float32))[None].to(self._device), *self._context)
            depth_mm: NDArray[np.float32] = output.depth_mm[0].float().cpu().numpy()
            valid: NDArray[np.bool_] = self.valid(output)[0].cpu().numpy()
            confidence, slip = (_in_numpy(values) for values in (self.confidence(output), self.slip(output)))
        return DepthEstimate(depth_mm=depth_mm, valid=valid, confidence=confidence, slip=slip)

    @abstractmethod
    def valid(self, output: Any) -> Tensor:
        """Return where the depth of the network's output is valid, (B, height, width)."""

    def confidence(self, output: Any) -> Tensor | None:  # noqa: ARG002 - for networks that know it
        """Return the probability of being within 1 mm, (B, height, width); None where the network does not say."""
        return None

    def slip(self, output: Any) -> Tensor | None:  # noqa: ARG002 - for networks that know it
        """Return the probability of a slip, (B, height, width); None where the network does not say."""
        return None


class PhaseNetworkEstimator(NetworkEstimator):
    """Marks valid what lies in the working range and is hardly a slip; gives a confidence and the probability of a slip."""

    def __init__(
        self,
        rig: Rig,
        network: DepthNetwork,
        *,
        max_slip: float = 0.05,
        device: str = "cpu",
        precision: Precision = "auto",
    ) -> None:
        """Take over a network whose output is a `PhaseOutput`; further arguments are those of `NetworkEstimator`.

        Args:
            rig: See `NetworkEstimator`.
            network: The network.
            max_slip: Largest probability of a slip with which a pixel is valid.
            device: See `NetworkEstimator`.
            precision: See `NetworkEstimator`.

        Raises:
            InvalidValueError: If `max_slip` is not from 0 to 1; further errors are those of `NetworkEstimator`.
        """
        check_range("max_slip", max_slip, 0.0, 1.0)
        super().__init__(rig, network, device=device, precision=precision)
        self._max_slip = max_slip

    def valid(self, output: Any) -> Tensor:
        """Return where the depth lies in the working range and a slip is unlikely."""
        valid: Tensor = output.valid(self._max_slip)
        return valid

    def confidence(self, output: Any) -> Tensor:
        """Return the probability of being within 1 mm."""
        confidence: Tensor = output.confidence
        return confidence

    def slip(self, output: Any) -> Tensor:
        """Return the probability of a slip."""
        slip: Tensor = output.slip
        return slip


class MaskEstimator(NetworkEstimator):
    """Marks valid where the network gives tissue a probability above one half."""

    def valid(self, output: Any) -> Tensor:
        """Return where tissue is likelier than not."""
        tissue: Tensor = output.mask_logit > 0.0
        return tissue


class RangeEstimator(NetworkEstimator):
    """Marks valid where the depth lies in the working range, for networks without a confidence of their own.

    The paper takes validity from the reference camera, which a running system does not have. The range flags little: where it
    matters which pixels can be trusted, take an estimator with a confidence.
    """

    def __init__(
        self,
        rig: Rig,
        network: DepthNetwork,
        *,
        range_mm: tuple[float, float] = WORKING_RANGE_MM,
        device: str = "cpu",
        precision: Precision = "auto",
    ) -> None:
        """Take over a network; the default range is the working range. Other arguments: see `NetworkEstimator`.

        Raises:
            InvalidValueError: If the range is empty; further errors are those of `NetworkEstimator`.
        """
        if not 0.0 < range_mm[0] < range_mm[1] < math.inf:
            raise InvalidValueError("range_mm", range_mm, "0 < nearest < farthest")
        super().__init__(rig, network, device=device, precision=precision)
        self._range_mm = range_mm

    def valid(self, output: Any) -> Tensor:
        """Return where the depth lies in the range."""
        inside: Tensor = (output.depth_mm >= self._range_mm[0]) & (output.depth_mm <= self._range_mm[1])
        return inside


def _in_numpy(values: Tensor | None) -> NDArray[np.float32] | None:
    """Return the first of a batch as an array (height, width)."""
    if values is None:
        return None
    array: NDArray[np.float32] = values[0].float().cpu().numpy()
    return array
