"""Public monocular depth networks as baselines: MiDaS's DPT-Large and Depth Anything, through `transformers`.

They know nothing of stripes or of millimetres: what they predict is inverse depth up to an unknown scale and shift. Two ways to
make millimetres of it are offered. Raw: each image's prediction is stretched to a range of depth, without any truth. Fitted:
scale and shift are chosen for each image by least squares in inverse depth against the truth that the estimate is then measured
by, as the literature on relative depth does (Ranftl et al., 2022); that is the best such a network could look.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError, WeightsError
from laploop.perception.estimators.base import check_image
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.working_range import WORKING_RANGE_MM

FARTHEST_MM = 250.0
"""Estimates end here: the upper end of the depth range of the paper's data set."""

_EDGE_PERCENT = 2.0
"""Percentage of the pixels at either end that the raw stretch clips, against single outliers."""
_UNUSED = ("fusion_stage.layers.0.residual_layer1.", "pooler.")
"""Weights that published checkpoints lack because the forward pass never uses them."""


@dataclass(frozen=True, kw_only=True)
class MonocularModel:
    """A published family of networks."""

    hub_id: str
    model_type: str
    """What its configuration calls itself."""
    mean: tuple[float, float, float]
    deviation: tuple[float, float, float]
    """Of the three channels, values from 0 to 1, as in training."""


MODELS = {
    "dpt": MonocularModel(hub_id="Intel/dpt-large", model_type="dpt", mean=(0.5, 0.5, 0.5), deviation=(0.5, 0.5, 0.5)),
    "depth-anything": MonocularModel(
        hub_id="LiheYoung/depth-anything-large-hf",
        model_type="depth_anything",
        mean=(0.485, 0.456, 0.406),
        deviation=(0.229, 0.224, 0.225),
    ),
}
"""The baselines by name."""


class MonocularEstimator:
    """Runs a monocular network on one image at a time; it has no confidence, so that all pixels are valid."""

    def __init__(
        self,
        rig: Rig,
        network: Any,
        model: MonocularModel,
        *,
        range_mm: tuple[float, float] = WORKING_RANGE_MM,
        device: str = "cpu",
    ) -> None:
        """Take over a network of `transformers`' depth estimation class.

        Raises:
            InvalidValueError: If `range_mm`, to which a raw prediction is stretched, is not a range of depth, or this machine
                does not have the device.
        """
        from laploop.perception.inference.torch_runner import check_device

        check_device(device)
        if not 0.0 < range_mm[0] < range_mm[1] <= FARTHEST_MM:
            raise InvalidValueError("range_mm", range_mm, f"0 < nearest < farthest <= {FARTHEST_MM:g}")
        self._rig = rig
        self._range_mm = range_mm
        self._device = device
        self._network = network.eval().to(device)
        self._network.requires_grad_(requires_grad=False)
        self._mean, self._deviation = model.mean, model.deviation
        self._size = _input_size(network.config)

    @classmethod
    def from_pretrained(cls, rig: Rig, weights: Path | None = None, *, name: str, device: str = "cpu") -> "MonocularEstimator":
        """Load a network, one of `MODELS`, from a local folder, or without one from the hub's cache on this machine.

        Nothing is downloaded or unpickled.

        Raises:
            UnknownNameError: If `name` is none of `MODELS`.
            MissingFileError: If `transformers`, the folder or the model is not at hand.
            WeightsError: If the files are damaged or of another architecture.
        """
        if name not in MODELS:
            raise UnknownNameError("monocular model", name, MODELS)
        model = MODELS[name]
        try:
            from safetensors import SafetensorError
            from transformers import AutoConfig, AutoModelForDepthEstimation
        except ImportError as error:
            raise MissingFileError(
                "package transformers", "this Python environment", "run `pip install 'laploop[monocular]'`"
            ) from error
        if weights is not None and not (Path(weights) / "config.json").is_file():
            raise MissingFileError(f"model {name!r}", weights, "give a folder with config.json and model.safetensors")
        source = model.hub_id if weights is None else str(weights)
        try:
            config: Any = AutoConfig.from_pretrained(source, local_files_only=True)
            if config.model_type != model.model_type:
                raise WeightsError(f"{source} holds a model of type {config.model_type!r}; {name!r} needs {model.model_type!r}")
            network, found = AutoModelForDepthEstimation.from_pretrained(
                source, config=config, local_files_only=True, use_safetensors=True, output_loading_info=True
            )
        except OSError as error:
            where = f"the hub's cache ({source})" if weights is None else source
            remedy = f"fetch it with `hf download {model.hub_id}`, or give a folder with config.json and model.safetensors"
            raise MissingFileError(f"model {name!r}", where, remedy) from error
        except (ValueError, KeyError, RuntimeError, SafetensorError) as error:
            if isinstance(error, WeightsError):
                raise
            raise WeightsError(f"cannot read the model in {source}: {error}") from error
        missing = [key for key in found["missing_keys"] if not any(unused in key for unused in _UNUSED)]
        if missing:
            raise WeightsError(f"the model in {source} lacks {len(missing)} weights, among them {min(missing)}")
        return cls(rig, network, model, device=device)

    def relative_inverse_depth(self, image: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return what the network predicts for an image (height, width): larger is nearer, scale and shift unknown.

        Raises:
            InvalidValueError: If the image is not what the rig's camera delivers.
        """
        import torch
        from torch.nn import functional

        check_image(image, self._rig)
        with torch.inference_mode():
            grey = torch.from_numpy(image.astype(np.float32) / np.float32(255.0)).to(self._device)[None, None]
            resized = functional.interpolate(grey, size=self._size, mode="bicubic", align_corners=False).expand(-1, 3, -1, -1)
            mean = torch.tensor(self._mean, device=self._device)[:, None, None]
            deviation = torch.tensor(self._deviation, device=self._device)[:, None, None]
            predicted = self._network(pixel_values=(resized - mean) / deviation).predicted_depth
            full = functional.interpolate(predicted[:, None], size=image.shape, mode="bicubic", align_corners=False)
        found: NDArray[np.float64] = full[0, 0].cpu().numpy().astype(np.float64)
        return found

    def estimate(self, image: NDArray[np.uint8]) -> DepthEstimate:
        """Estimate z-depth in millimetres from an image (height, width), raw: see `stretched`."""
        return self.stretched(self.relative_inverse_depth(image))

    def stretched(self, relative: NDArray[np.float64]) -> DepthEstimate:
        """Make depth of a prediction (H, W) without truth: its range becomes that of depth, linearly in inverse depth."""
        near_mm, far_mm = self._range_mm
        low, high = np.percentile(relative, (_EDGE_PERCENT, 100.0 - _EDGE_PERCENT))
        nearness = np.clip((relative - low) / max(high - low, 1e-12), 0.0, 1.0)
        return _estimate(1.0 / (1.0 / far_mm + nearness * (1.0 / near_mm - 1.0 / far_mm)))


dpt = partial(MonocularEstimator.from_pretrained, name="dpt")
depth_anything = partial(MonocularEstimator.from_pretrained, name="depth-anything")


def fitted(relative: NDArray[np.float64], truth_mm: NDArray[np.float32], mask: NDArray[np.bool_]) -> DepthEstimate:
    """Make depth of a prediction by the scale and shift that fit 1 / truth best where `mask` holds; all (H, W).

    Inverse depths that would lie beyond `FARTHEST_MM`, or behind the camera, are put there.

    Raises:
        InvalidValueError: If shapes differ, or fewer than two pixels are left to fit.
    """
    if not relative.shape == truth_mm.shape == mask.shape:
        raise InvalidValueError("shapes", (relative.shape, truth_mm.shape, mask.shape), "three equal shapes")
    if int(mask.sum()) < 2:
        raise InvalidValueError("pixels to fit", int(mask.sum()), "two or more")
    design = np.stack([relative[mask], np.ones(int(mask.sum()))], axis=1)
    scale, shift = np.linalg.lstsq(design, 1.0 / truth_mm[mask].astype(np.float64), rcond=None)[0]
    return _estimate(1.0 / np.maximum(scale * relative + shift, 1.0 / FARTHEST_MM))


def _estimate(depth_mm: NDArray[np.float64]) -> DepthEstimate:
    return DepthEstimate(depth_mm=depth_mm.astype(np.float32), valid=np.ones(depth_mm.shape, dtype=np.bool_))


def _input_size(config: Any) -> tuple[int, int]:
    """Return the (height, width) that a network was trained at."""
    backbone = getattr(config, "backbone_config", None)
    size = getattr(backbone, "image_size", None) or config.image_size
    height, width = (size, size) if isinstance(size, int) else size
    return int(height), int(width)
