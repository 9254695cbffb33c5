"""ONNX Runtime and OpenVINO as runtimes on the CPU; both take the network through an ONNX file."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.inference.depth_module import DepthModule
from laploop.perception.inference.export import INPUT, export_onnx, require_packages


class OnnxRuntimeRunner:
    """Runs a depth network in ONNX Runtime, float32, on the CPU."""

    backend: ClassVar[str] = "onnxruntime"
    precision = "fp32"
    device_ms = None

    def __init__(self, module: DepthModule, *, size: tuple[int, int], threads: int | None = None) -> None:
        """Export the module for images of `size` (height, width) and load it."""
        require_packages("onnxruntime")
        import onnxruntime  # slow to import, and not everybody has it

        self.outputs = module.outputs
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads or torch.get_num_threads()
        options.inter_op_num_threads = 1
        with TemporaryDirectory() as folder:
            path = _export(module, size, Path(folder))
            self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    def run(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        """Estimate from one image (height, width); each result is (height, width)."""
        results = self._session.run(list(self.outputs), {INPUT: image[None].astype(np.float32)})
        return tuple(result[0] for result in results)


class OpenVinoRunner:
    """Runs a depth network in OpenVINO on the CPU, in float32 or bfloat16."""

    backend: ClassVar[str] = "openvino"
    device_ms = None

    def __init__(
        self, module: DepthModule, *, size: tuple[int, int], threads: int | None = None, precision: str = "fp32"
    ) -> None:
        """Export the module for images of `size` (height, width) and compile it."""
        hints = {"fp32": "f32", "bf16": "bf16"}
        if precision not in hints:
            raise InvalidValueError("precision", precision, ", ".join(hints))
        require_packages("openvino", extra="openvino")
        import openvino  # slow to import, and not everybody has it

        self.outputs, self.precision = module.outputs, precision
        options: dict[str, Any] = {
            "INFERENCE_PRECISION_HINT": hints[precision],
            "PERFORMANCE_HINT": "LATENCY",
            "INFERENCE_NUM_THREADS": threads or torch.get_num_threads(),
        }
        with TemporaryDirectory() as folder:
            compiled = openvino.Core().compile_model(_export(module, size, Path(folder)), "CPU", options)
        self._request: Any = compiled.create_infer_request()

    def run(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], ...]:
        """Estimate from one image (height, width); each result is (height, width)."""
        results = self._request.infer({INPUT: image[None].astype(np.float32)}, share_outputs=False)
        return tuple(np.asarray(results[name][0], dtype=np.float32) for name in self.outputs)


def _export(module: DepthModule, size: tuple[int, int], folder: Path) -> str:
    path = folder / "network.onnx"
    export_onnx(module, path, torch.zeros((1, *size)))
    return str(path)
