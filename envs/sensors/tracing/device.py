"""Warp devices with our kernels compiled for them."""

import contextlib
import os
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from laploop.envs.sensors.kernels import ray_kernels, shading_kernels, shadow_kernels, spread_kernels, zbuffer_kernels
from laploop.errors import LaploopNote, OutputError, UnknownNameError

_PATIENCE_S = 3.0
"""Loading compiled kernels takes a tenth of that."""


def open_device(name: str) -> wp.Device:
    """Return a Warp device with our kernels compiled for it: seconds the first time, then from the user's cache.

    Args:
        name: "cpu", "cuda", "cuda:0", ...

    Raises:
        UnknownNameError: If this machine has no such device.
        OutputError: If the cache lacks the kernels and cannot be written.
    """
    try:
        with _quiet_warp():
            available = [device.alias for device in wp.get_devices()]
            if wp.is_cuda_available():
                available.append("cuda")
            if name not in available:
                raise UnknownNameError("device", name, available)
            device = wp.get_device(name)
            with _patience(name):
                for module in (ray_kernels, shading_kernels, shadow_kernels, spread_kernels, zbuffer_kernels):
                    wp.load_module(module, device=device)
    except OSError as error:
        remedy = "set WARP_CACHE_PATH to a folder that can be written"
        raise OutputError(
            f"cannot keep compiled kernels in {wp.config.kernel_cache_dir}: {error.strerror}; {remedy}"
        ) from error
    return device


def kernel_cache() -> Path:
    """Return the folder that keeps compiled kernels; known once a device was opened."""
    return Path(wp.config.kernel_cache_dir or ".")


@contextlib.contextmanager
def _patience(device: str) -> Iterator[None]:
    """Say in one line what takes so long, where loading the kernels means compiling them."""
    text = f"compiling the ray caster for {device}, once for this machine and version: about a minute"
    note = threading.Timer(_PATIENCE_S, warnings.warn, [text, LaploopNote])
    note.daemon = True
    note.start()
    try:
        yield
    finally:
        note.cancel()


@contextlib.contextmanager
def _quiet_warp() -> Iterator[None]:
    """Silence Warp's greeting and its notes about compiling."""
    before = wp.config.log_level
    wp.config.log_level = max(before, wp.LOG_ERROR)
    try:
        with _without_driver_warning():
            wp.get_devices()
        yield
    finally:
        wp.config.log_level = before


@contextlib.contextmanager
def _without_driver_warning() -> Iterator[None]:
    """Hold back the line that Warp's library prints where there is no GPU, and no other; no option turns it off."""
    try:
        standard_error = os.dup(2)
    except OSError:
        # Standard error is closed.
        yield
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    os.dup2(writer, 2)
    os.close(writer)
    try:
        yield
    finally:
        os.dup2(standard_error, 2)
        os.close(standard_error)
        with os.fdopen(reader, "rb") as printed:
            lines = [line for line in printed if b"Could not find or load the NVIDIA CUDA driver" not in line]
        if lines:
            os.write(2, b"".join(lines))
