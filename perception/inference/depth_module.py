"""A depth network reduced to what inference needs: tensors in, tensors out."""

from dataclasses import fields, is_dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from laploop.errors import InvalidValueError

OUTPUTS = ("depth_mm", "confidence", "slip")
"""Outputs that a network may have, in this order; all but the first only if it knows how far its depth can be trusted."""

Context = Any
"""A dataclass of tensors (or tuples of tensors) that a network is called with beside the image."""


class DepthModule(nn.Module):
    """Calls a network with an image alone and returns a tuple of tensors; what stays from frame to frame becomes buffers.

    This is the form that can be traced, exported, and captured in a CUDA graph.
    """

    def __init__(self, network: nn.Module, context: Context | None = None, *, outputs: tuple[str, ...] = OUTPUTS) -> None:
        """Take a network into inference form.

        Args:
            network: Called with images (B, height, width), grey values 0-255 in float32, and the context where there is one;
                returns an object with `depth_mm`, and perhaps `confidence` and `slip`, each (B, height, width).
            context: What the network needs beside the image, a dataclass of tensors.
            outputs: Names of the tensors to return.

        Raises:
            InvalidValueError: If the context is not a dataclass of tensors.
        """
        super().__init__()
        self.network = network.eval().requires_grad_(requires_grad=False)
        self.outputs = outputs
        self._kind: type[Any] | None = None
        self._layout: tuple[tuple[str, int], ...] = ()
        if context is not None:
            self._keep(context)
        self.eval()

    def _keep(self, context: Context) -> None:
        if not is_dataclass(context) or isinstance(context, type):
            raise InvalidValueError("context", context, "a dataclass of tensors, or None")
        self._kind = type(context)
        layout: list[tuple[str, int]] = []
        for field in fields(context):
            value = getattr(context, field.name)
            parts = value if isinstance(value, tuple) else (value,)
            if not all(isinstance(part, Tensor) for part in parts):
                raise InvalidValueError(f"context.{field.name}", value, "a tensor or a tuple of tensors")
            for index, part in enumerate(parts):
                self.register_buffer(f"context_{field.name}_{index}", part, persistent=False)
            layout.append((field.name, len(parts) if isinstance(value, tuple) else 0))
        self._layout = tuple(layout)

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """Estimate from images (B, height, width), grey values 0-255 in float32."""
        if self._kind is None:
            result = self.network(image)
        else:
            values: dict[str, Tensor | tuple[Tensor, ...]] = {}
            for name, count in self._layout:
                parts = tuple(self.get_buffer(f"context_{name}_{index}") for index in range(max(1, count)))
                values[name] = parts if count else parts[0]
            result = self.network(image, self._kind(**values))
        return tuple(getattr(result, name) for name in self.outputs)


def fold_batch_norms(module: nn.Module) -> int:
    """Fold every batch normalisation that follows a convolution in an `nn.Sequential` into it; return how many.

    The module must be in evaluation mode. What it computes changes by rounding alone.
    """
    folded = 0
    for sequence in [part for part in module.modules() if isinstance(part, nn.Sequential)]:
        for index in range(len(sequence) - 1):
            convolution, norm = sequence[index], sequence[index + 1]
            if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                sequence[index] = fuse_conv_bn_eval(convolution, norm)
                sequence[index + 1] = nn.Identity()
                folded += 1
    return folded


class _FullPrecision(nn.Module):
    """Runs a layer in float32 inside an autocast region."""

    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        self.layer = layer

    def forward(self, x: Tensor) -> Tensor:
        with torch.autocast(device_type=x.device.type, enabled=False):
            result: Tensor = self.layer(x.float())
        return result


def lower_precision(module: nn.Module, *, codebook_exact: bool = False) -> None:
    """Store the weights of convolutions in bfloat16, to be run under autocast, but for the last one.

    The last convolution produces the depth. With 8 bits of mantissa, 250 mm is known to 0.5 mm only, more than the rest of the
    network loses; it is also the cheapest, having few outputs.

    Args:
        module: Changed in place.
        codebook_exact: Leave what comes before a `DepthModule`'s codebook in float32: where the nearest entry is a close call,
            rounding picks another one, and the error is no longer small.
    """
    exact = "network.encoder" if codebook_exact and hasattr(getattr(module, "network", None), "quantizer") else None
    layers = [
        (name, layer)
        for name, layer in module.named_modules()
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d) and not (exact and name.startswith(f"{exact}."))
    ]
    for _, layer in layers[:-1]:
        layer.to(torch.bfloat16)
    for name in (exact, layers[-1][0] if layers else None):
        if name is not None:
            parent, _, leaf = name.rpartition(".")
            setattr(module.get_submodule(parent), leaf, _FullPrecision(module.get_submodule(name)))
