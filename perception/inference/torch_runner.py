"""Torch as a runtime: eager or compiled, on the CPU or on a CUDA GPU, in float32 or bfloat16."""

import re
from contextlib import nullcontext
from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from laploop.errors import InvalidValueError
from laploop.perception.inference.depth_module import DepthModule, fold_batch_norms, lower_precision

PRECISIONS = ("fp32", "mixed", "bf16")
"""`mixed` is bfloat16 behind a network's codebook, if it has one, and float32 before it."""

_WARM_UPS = 3
"""Runs before a CUDA graph is captured: libraries choose their kernels and take their memory."""


def has_fast_bf16(device: str = "cpu") -> bool:
    """Return whether the device multiplies bfloat16 in hardware; elsewhere it is emulated and slower than float32."""
    if torch.device(device).type == "cuda":
        return bool(torch.cuda.is_available() and torch.cuda.is_bf16_supported(including_emulation=False))
    found = torch.cpu.get_capabilities()
    return bool(found.get("avx512_bf16") or found.get("amx_bf16"))


def check_device(device: str) -> None:
    """Raise an `InvalidValueError` unless the device is `cpu` or a CUDA GPU that torch sees."""
    if not re.fullmatch(r"cpu|cuda(:\d{1,3})?", device):
        raise InvalidValueError("device", device, "cpu, cuda, or cuda:N")
    if device != "cpu" and not torch.cuda.is_available():
        raise InvalidValueError("device", device, "cpu; torch sees no CUDA GPU on this machine")
    if device.startswith("cuda:") and int(device[5:]) >= torch.cuda.device_count():
        raise InvalidValueError("device", device, f"cuda:0 to cuda:{torch.cuda.device_count() - 1}")


class TorchRunner:
    """Runs a depth network on one image at a time; the same image gives the same bits.

    Convolutions in channels-last order, batch normalisations folded into them. In bfloat16 the layers run under autocast,
    the last convolution in float32. On a GPU everything from the grey values to the depth is one CUDA graph, replayed for
    every frame, and the attention is torch's fused one.
    """

    backend: ClassVar[str] = "torch"

    def __init__(self, module: DepthModule, *, device: str = "cpu", precision: str = "fp32") -> None:
        """Prepare a copy of the module; the module itself stays as it is.

        Raises:
            InvalidValueError: If device or precision is not one of those there are.
        """
        check_device(device)
        if precision not in PRECISIONS:
            raise InvalidValueError("precision", precision, ", ".join(PRECISIONS))
        self.device, self.precision = torch.device(device), precision
        self.outputs = module.outputs
        prepared = deepcopy(module).eval()
        fold_batch_norms(prepared)
        if precision != "fp32":
            lower_precision(prepared, codebook_exact=precision == "mixed")
        self._module: Any = prepared.to(self.device).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self._graph: _CudaGraph | None = None

    def run(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        """Estimate from one image (height, width); each result is (height, width)."""
        with torch.inference_mode():
            if self.device.type == "cuda":
                if self._graph is None or self._graph.shape != image.shape:
                    self._graph = _CudaGraph(self._forward, image.shape, self.device)
                return self._graph.replay(image)
            return tuple(output[0].numpy() for output in self._forward(torch.from_numpy(image)))

    @property
    def device_ms(self) -> float | None:
        """Time on the GPU of the last frame without the copies, from CUDA events; None on the CPU."""
        return None if self._graph is None else self._graph.elapsed_ms()

    def _forward(self, grey: Tensor) -> tuple[Tensor, ...]:
        """Run the network on a grey-value image (height, width) that is on the device."""
        lower = self.precision != "fp32"
        # The weights are in bfloat16 already, so that there is nothing to cache; and a graph must not hold the cache's tensors.
        region = torch.autocast(self.device.type, torch.bfloat16, cache_enabled=False) if lower else nullcontext()
        with region:
            outputs: tuple[Tensor, ...] = self._module(grey.to(torch.float32)[None])
        return tuple(output.float() for output in outputs)


class CompiledRunner(TorchRunner):
    """The same through `torch.compile`, which needs a C++ compiler on the CPU and some ten seconds at the first image."""

    backend: ClassVar[str] = "compile"

    def __init__(self, module: DepthModule, *, device: str = "cpu", precision: str = "fp32") -> None:
        super().__init__(module, device=device, precision=precision)
        self._module = torch.compile(self._module, fullgraph=False, dynamic=False)

    def run(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        """Estimate from one image (height, width); each result is (height, width).

        Raises:
            InvalidValueError: If there is no working compiler.
        """
        from torch._dynamo.exc import BackendCompilerFailed  # slow to import; compiling has loaded it

        try:
            return super().run(image)
        except BackendCompilerFailed as error:
            allowed = "torch: torch.compile found no working C++ compiler (install g++ to use it)"
            raise InvalidValueError("backend", self.backend, allowed) from error


class _CudaGraph:
    """One captured forward pass with its input and output buffers, pinned on the host's side."""

    def __init__(self, forward: Any, shape: tuple[int, ...], device: torch.device) -> None:
        self.shape = shape
        self._host_in = torch.zeros(shape, dtype=torch.uint8, pin_memory=True)
        self._grey = torch.zeros(shape, dtype=torch.uint8, device=device)
        self._begin, self._end = (torch.cuda.Event(enable_timing=True) for _ in range(2))  # type: ignore[no-untyped-call]
        self._stream = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
        self._stream.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(self._stream), torch.backends.cudnn.flags(benchmark=True, allow_tf32=False):
            for _ in range(_WARM_UPS):
                forward(self._grey)
            self._stream.synchronize()
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph, stream=self._stream):
                self._outputs = forward(self._grey)
        self._host_out = tuple(torch.empty(output.shape, dtype=output.dtype, pin_memory=True) for output in self._outputs)

    def replay(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        self._host_in.numpy()[...] = image
        with torch.cuda.stream(self._stream):
            self._grey.copy_(self._host_in, non_blocking=True)
            self._begin.record()
            self._graph.replay()
            self._end.record()
            for host, output in zip(self._host_out, self._outputs, strict=True):
                host.copy_(output, non_blocking=True)
        self._stream.synchronize()
        return tuple(host[0].numpy().copy() for host in self._host_out)

    def elapsed_ms(self) -> float:
        return float(self._begin.elapsed_time(self._end))
