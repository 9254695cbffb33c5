"""Runtimes by name."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.inference.depth_module import DepthModule
from laploop.perception.inference.torch_runner import CompiledRunner, TorchRunner, check_device

MOST_THREADS = 1024
BACKENDS = ("torch", "compile", "onnxruntime", "openvino")
"""Runtimes for a depth network."""


class DepthRunner(Protocol):
    """Runs a depth network on one image at a time; the same image gives the same bits."""

    outputs: tuple[str, ...]
    """Names of the results."""
    precision: str

    @property
    def device_ms(self) -> float | None:
        """Time of the last frame on a GPU alone, without copies; None on the CPU."""
        ...

    def run(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        """Estimate from one image (height, width); each result is (height, width)."""
        ...


PRECISIONS_OF = {
    "torch": ("bf16", "mixed", "fp32"),
    "compile": ("bf16", "mixed", "fp32"),
    "onnxruntime": ("fp32",),
    "openvino": ("bf16", "fp32"),
}
"""What each runtime can compute in, the fastest first."""


def make_runner(
    module: DepthModule,
    backend: str,
    *,
    size: tuple[int, int],
    device: str = "cpu",
    precision: str = "fp32",
    threads: int | None = None,
) -> DepthRunner:
    """Prepare a network for a runtime.

    Args:
        module: The network; it stays as it is.
        backend: One of `BACKENDS`.
        size: Of the images, (height, width).
        device: `cpu` or `cuda`; ONNX Runtime and OpenVINO run on the CPU alone.
        precision: `fp32`, `bf16`, or `mixed` (torch alone): bfloat16 behind a network's codebook.
        threads: On the CPU, for ONNX Runtime and OpenVINO; as many as torch's by default.

    Raises:
        UnknownNameError: If there is no such backend.
        InvalidValueError: If the backend cannot have device or precision, or the number of threads is impossible.
        MissingFileError: If its packages are not installed.
    """
    if backend not in BACKENDS:
        raise UnknownNameError("backend", backend, BACKENDS)
    check_device(device)
    if threads is not None and (not isinstance(threads, int) or not 1 <= threads <= MOST_THREADS):
        raise InvalidValueError("threads", threads, f"an integer, 1 to {MOST_THREADS}, or None")
    if precision not in PRECISIONS_OF[backend]:
        raise InvalidValueError("precision", precision, f"{', '.join(PRECISIONS_OF[backend])} for the backend {backend!r}")
    if backend in {"torch", "compile"}:
        kind = TorchRunner if backend == "torch" else CompiledRunner
        return kind(module, device=device, precision=precision)
    if not device.startswith("cpu"):
        raise InvalidValueError("device", device, f"cpu for the backend {backend!r}")
    from laploop.perception.inference.onnx_runners import OnnxRuntimeRunner, OpenVinoRunner

    if backend == "openvino":
        return OpenVinoRunner(module, size=size, threads=threads, precision=precision)
    return OnnxRuntimeRunner(module, size=size, threads=threads)
