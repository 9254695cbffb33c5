"""An optimiser for convolutional networks: orthogonalised momentum for kernels, torch's AdamW for everything else.

The momentum of a kernel, as a matrix of outputs by inputs, is replaced by the nearest matrix with equal singular values, so
that directions that seldom show in the gradient are learned as fast as the others: Muon (K. Jordan and others, 2024), found
by five Newton-Schulz iterations. Updates are scaled to the size that Adam's have (J. Liu and others, arXiv 2502.16982), so
that one learning rate serves both.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor, nn

from laploop.errors import InvalidValueError

_MOMENTUM = 0.95
_ADAM_SIZE = 0.2
"""Root mean square of an update of Adam's, in units of the learning rate."""
_QUINTIC = (3.4445, -4.7750, 2.0315)
"""Of the iteration X <- a X + b (X X') X + c (X X')^2 X, which brings singular values from 0..1 near 1 in five steps."""


class Muon(torch.optim.AdamW):
    """Steps of kernels by orthogonalised momentum, of vectors and of chosen layers by AdamW."""

    def __init__(
        self,
        kernels: Iterable[nn.Parameter],
        others: Iterable[nn.Parameter],
        *,
        lr: float,
        betas: tuple[float, float] = (0.9, 0.999),
        weight_decay: float = 0.0,
    ) -> None:
        """Take over kernels, outputs first, and other parameters; rate and decoupled decay are those of both, `betas` AdamW's.

        Raises:
            InvalidValueError: If a kernel has fewer than two dimensions.
        """
        matrices = list(kernels)
        for kernel in matrices:
            if kernel.ndim < 2:
                raise InvalidValueError("dimensions of a kernel", kernel.ndim, "2 or more")
        groups = [{"params": matrices, "kernels": True}, {"params": list(others), "kernels": False}]
        super().__init__([group for group in groups if group["params"]], lr=lr, betas=betas, weight_decay=weight_decay)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Take a step; returns what the closure does."""
        groups = self.param_groups
        try:
            # AdamW moves the groups that it sees.
            self.param_groups = [group for group in groups if not group["kernels"]]
            loss = super().step(closure)
        finally:
            self.param_groups = groups
        for group in groups:
            for parameter in group["params"] if group["kernels"] else ():
                if parameter.grad is not None:
                    change = self._kernel_update(self.state[parameter], parameter.grad)
                    parameter.mul_(1.0 - group["lr"] * group["weight_decay"]).add_(change, alpha=-group["lr"])
        return loss

    @staticmethod
    def _kernel_update(state: dict[str, Tensor], gradient: Tensor) -> Tensor:
        if not state:
            # AdamW looks for a step in every state that it is given back.
            state.update(step=torch.tensor(0.0), momentum=torch.zeros_like(gradient))
        momentum = state["momentum"].lerp_(gradient, 1.0 - _MOMENTUM)
        # Nesterov's look ahead.
        matrix = orthogonalize(gradient.lerp(momentum, _MOMENTUM).flatten(1))
        return matrix.mul_(_ADAM_SIZE * math.sqrt(max(matrix.shape))).view_as(gradient)


def orthogonalize(matrix: Tensor) -> Tensor:
    """Return about U V' of the singular value decomposition U S V' of a matrix (m, n), in float32.

    Singular values come out between about 0.7 and 1.2; the iteration runs in bfloat16, which is enough for that.
    """
    wide = matrix.T if matrix.shape[0] > matrix.shape[1] else matrix
    x = wide.bfloat16()
    x = x / (x.norm() + 1e-7)
    a, b, c = _QUINTIC
    for _ in range(5):
        square = x @ x.T
        x = a * x + (b * square + c * square @ square) @ x
    found: Tensor = x.T if matrix.shape[0] > matrix.shape[1] else x
    return found.float().contiguous()
