"""Time of a depth model for a frame, and nothing else: the measurement of the paper's section 3.2.

The clock runs from an image in the computer's memory (256 x 256, 8 bits) to a depth map there: conversion to float32, the copy
to the device and back where it is a GPU, and the network. Reading files, drawing and checking are outside. Frames follow each
other without a pause, after a warm-up that is not counted.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError
from laploop.perception.estimators import checked_estimate, make_estimator
from laploop.perception.geometry import Rig
from laploop.studies.csv_text import csv_text
from laploop.studies.timing.speed_config import AUTO, ESTIMATOR, PRECISIONS, SpeedConfig

Image = NDArray[np.uint8]

MAX_DIFFERENCE_MM = 0.1
"""How far, on average, a fast way to run a network may be off its float32 reference."""

_IMAGES = 16
"""Different images, shown in turn; the same number is compared with the reference."""
_LEAST_CONFIDENCE = 0.5
"""Pixels are compared where the network is surer than this."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SpeedResult:
    """Service times in the order of the frames, and what made them."""

    latency_ms: NDArray[np.float64]
    """(frames,) wall-clock time from image array to depth array."""
    device_ms: NDArray[np.float64] | None
    """(frames,) time of the GPU alone, without copies; None on a CPU."""
    backend: str
    precision: str | None
    """None for an estimator, which chooses itself."""
    difference_mm: float | None
    """Mean absolute difference to the float32 reference; None where there is no reference."""
    parameters: int | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, the trace left out."""
        p50, p99 = np.percentile(self.latency_ms, [50, 99])
        mean = float(self.latency_ms.mean())
        return {
            "mean_ms": mean,
            "p50_ms": float(p50),
            "p99_ms": float(p99),
            "max_ms": float(self.latency_ms.max()),
            "hz": 1e3 / mean,
            "p99_over_p50": float(p99 / p50),
            "device_p50_ms": None if self.device_ms is None else float(np.median(self.device_ms)),
            "backend": self.backend,
            "precision": self.precision,
            "difference_to_fp32_mm": self.difference_mm,
            "parameters": self.parameters,
        }


def measure_speed(config: SpeedConfig, progress: Callable[[float], None] | None = None) -> SpeedResult:
    """Time a model frame by frame; `progress` is called with the number of frames timed, outside the clock.

    Raises:
        InvalidValueError: If device, backend and precision do not go together.
        MissingFileError: If weights, data set or an optional package are not there.
        WeightsError: If the weights do not fit.
    """
    import torch  # slow to import

    from laploop.perception.inference.torch_runner import check_device
    from laploop.perception.network_specs import NETWORKS

    check_device(config.device)
    networked = config.model in NETWORKS.names()
    if not networked and (config.backend not in {AUTO, ESTIMATOR} or config.random_weights):
        raise InvalidValueError("backend", config.backend, f"auto or estimator for {config.model!r}, which is not one network")
    rig, images = _frames(config)
    before = torch.get_num_threads()
    if config.threads is not None:
        torch.set_num_threads(config.threads)
    try:
        if networked and config.backend != ESTIMATOR:
            return _time_network(config, rig, images, progress)
        if config.device != "cpu":
            raise InvalidValueError("device", config.device, "cpu for the backend 'estimator'")
        estimator = make_estimator(config.model, rig, config.weights)
        checked_estimate(estimator.estimate(images[0]), (rig.camera.height, rig.camera.width))
        latency, _ = _time(config, images, estimator.estimate, lambda: None, progress)
        return SpeedResult(
            latency_ms=latency, device_ms=None, backend=ESTIMATOR, precision=None, difference_mm=None, parameters=None
        )
    finally:
        torch.set_num_threads(before)


def _time_network(config: SpeedConfig, rig: Rig, images: list[Image], progress: Callable[[float], None] | None) -> SpeedResult:
    from laploop.perception.inference.models import random_module, trained_module
    from laploop.perception.inference.runner import PRECISIONS_OF, DepthRunner, make_runner
    from laploop.perception.inference.torch_runner import TorchRunner, has_fast_bf16

    if config.random_weights:
        module = random_module(config.model, rig, config.size, seed=config.seed)
    else:
        module = trained_module(config.model, rig, config.weights)
    backend = "torch" if config.backend == AUTO else config.backend
    choices: tuple[str, ...] = (config.precision,)
    if config.precision == AUTO:
        fast = has_fast_bf16(config.device) and backend != "compile"
        choices = PRECISIONS_OF[backend] if fast else ("fp32",)
    reference = TorchRunner(module, device=config.device)
    expected = [reference.run(image) for image in images[:_IMAGES]]

    runner: DepthRunner | None = None
    difference = float("inf")
    for precision in choices:
        runner = make_runner(
            module,
            backend,
            size=(rig.camera.height, rig.camera.width),
            device=config.device,
            precision=precision,
            threads=config.threads,
        )
        difference = _difference_mm(runner, images, expected)
        if difference <= MAX_DIFFERENCE_MM:
            break
    if runner is None:
        raise UnknownNameError("precision", config.precision, PRECISIONS)
    chosen = runner
    latency, device = _time(config, images, chosen.run, lambda: chosen.device_ms, progress)
    return SpeedResult(
        latency_ms=latency,
        device_ms=device,
        backend=backend,
        precision=chosen.precision,
        difference_mm=difference,
        parameters=sum(parameter.numel() for parameter in module.parameters()),
    )


def _difference_mm(runner: Any, images: list[Image], expected: list[tuple[NDArray[np.float32], ...]]) -> float:
    """Return the mean absolute difference of depth over the pixels that the reference marks valid."""
    sums, count = 0.0, 0
    for image, wanted in zip(images, expected, strict=False):
        found = runner.run(image)[0]
        valid = np.isfinite(wanted[0])
        if len(wanted) > 1 and (sure := wanted[1] >= _LEAST_CONFIDENCE).any():
            valid &= sure
        sums += float(np.abs(found - wanted[0])[valid].sum(dtype=np.float64))
        count += int(valid.sum())
    return sums / max(1, count)


def _time(
    config: SpeedConfig,
    images: list[Image],
    call: Callable[[Image], Any],
    device_ms: Callable[[], float | None],
    progress: Callable[[float], None] | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
    for index in range(config.warm_up):
        call(images[index % len(images)])
    latency = np.empty(config.frames)
    device: list[float] = []
    for index in range(config.frames):
        image = images[index % len(images)]
        begin = time.perf_counter_ns()
        call(image)
        latency[index] = (time.perf_counter_ns() - begin) * 1e-6
        on_device = device_ms()
        if on_device is not None:
            device.append(on_device)
        # Rarely, for the terminal is drawn by another thread that would wake up in the next frame.
        if progress is not None and (index + 1) % 50 == 0:
            progress(index + 1)
    return latency, np.array(device) if device else None


def _frames(config: SpeedConfig) -> tuple[Rig, list[Image]]:
    if config.dataset is None:
        rig = Rig.from_optics(ScopeOptics())
        return rig, drawn_frames(rig, _IMAGES, np.random.default_rng(config.seed))
    from laploop.perception.data.datasets import open_dataset

    dataset = open_dataset(config.dataset)
    indices = dataset.indices("test")
    if not len(indices):
        raise MissingFileError("test frames", config.dataset, "give a data set with frames in its test split")
    chosen = indices[np.linspace(0, len(indices) - 1, _IMAGES).astype(np.intp)]
    return Rig.from_optics(dataset.optics), [dataset.image(int(index)) for index in chosen]


def drawn_frames(rig: Rig, count: int, rng: np.random.Generator) -> list[Image]:
    """Draw what the camera of a rig sees of slanted, lit planes between 70 and 130 mm, with shot noise."""
    rays, mask = rig.camera.rays, rig.mask
    frames: list[Image] = []
    for _ in range(count):
        slope = rng.uniform(-0.3, 0.3, 2)
        depth_m = rng.uniform(0.07, 0.13) / (1.0 - rays[..., 0] * slope[0] - rays[..., 1] * slope[1])
        place = (rig.projector_x(depth_m) + mask.half_width_tan) / mask.period_tan - mask.phase
        wave = 0.5 + 0.5 * np.tanh(4.0 * np.cos(2.0 * np.pi * (place - 0.5 * mask.duty)))
        grey = 15.0 + 135.0 * wave * ((place > 0.0) & (place < mask.stripes))
        frames.append(np.clip(rng.normal(grey, 0.16 * np.sqrt(grey)), 0.0, 255.0).astype(np.uint8))
    return frames


def trace_csv(result: SpeedResult) -> str:
    """Write the service times as CSV: `frame,latency_ms`, on a GPU also `device_ms`; what `laploop run` can replay."""
    times = {"latency_ms": result.latency_ms} | ({} if result.device_ms is None else {"device_ms": result.device_ms})
    rows = zip(*times.values(), strict=True)
    return csv_text(("frame", *times), ((index, *(f"{ms:.6f}" for ms in row)) for index, row in enumerate(rows)))
