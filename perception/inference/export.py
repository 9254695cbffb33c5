"""Export of depth networks to ONNX, for runtimes other than torch.

The file has one input, `image` (1, height, width) float32 with grey values 0-255, and the outputs `depth_mm` and, where the
network knows them, `confidence` and `slip`, each (1, height, width) float32. The rig's geometry is part of the file, so that a
network for another rig is another file.
"""

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor

from laploop.errors import InvalidValueError, MissingFileError
from laploop.perception.inference.depth_module import DepthModule
from laploop.whole_file import whole_file

INPUT = "image"


def export_onnx(network: DepthModule, path: Path, example: Tensor) -> None:
    """Write a network as one ONNX file, weights included, atomically.

    Args:
        network: In inference form; it is moved to the CPU and to float32 order of memory.
        path: The file; its folder must exist.
        example: An image (1, height, width) float32 of the size that the file is to take.

    Raises:
        InvalidValueError: If the example is not such an image.
        MissingFileError: If a package of the extra `onnx` is not installed.
        OutputError: If the file cannot be written.
    """
    if example.ndim != 3 or len(example) != 1 or example.dtype != torch.float32:
        raise InvalidValueError("example", (tuple(example.shape), example.dtype), "(1, height, width) float32")
    require_packages("onnx", "onnxscript")
    # Strides other than the plain ones would become transpositions in the file.
    network = network.cpu().to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    with _quiet(), torch.inference_mode():
        program = torch.onnx.export(
            network,
            (example,),
            dynamo=True,
            input_names=[INPUT],
            output_names=list(network.outputs),
            verbose=False,
        )
    if program is None:
        raise InvalidValueError("network", type(network.network).__name__, "one that torch.onnx can trace")
    with whole_file(path) as partial:
        program.save(str(partial), external_data=False)


def require_packages(*packages: str, extra: str = "onnx") -> None:
    """Raise a `MissingFileError`, which names the optional extra, unless its packages are installed."""
    for package in packages:
        if find_spec(package) is None:
            raise MissingFileError(
                f"package {package}", "this Python environment", f"install it with: pip install 'laploop[{extra}]'"
            )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the exporter's progress, and warnings of its own outdated calls, from the user's terminal."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            warnings.simplefilter("ignore", DeprecationWarning)
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
