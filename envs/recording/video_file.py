"""Pictures as an MP4 file, or as an animated WebP picture."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from laploop.errors import OutputError

VIDEO_SUFFIXES = (".mp4", ".webp")
"""Of the kinds of files that can be written."""

_WEBP_FPS = 12.5
"""Pictures a second of an animated picture, at most: 5.6 s of a run on breathing tissue are 0.7 MB."""
_WEBP_SCALE = 2.0 / 3.0
_WEBP_QUALITY = 60


class VideoWriter(Protocol):
    """Takes the pictures of a video."""

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append a picture, RGB, (height, width, 3)."""


@contextmanager
def video_writer(path: Path, *, size: tuple[int, int], fps: float) -> Iterator[VideoWriter]:
    """Write an MP4 file or an animated WebP picture while the block runs.

    MP4 is H.264 where imageio-ffmpeg is installed, MPEG-4 otherwise. An animated picture repeats for ever, has at most 12.5
    pictures a second, of two thirds of the size, and is held in memory until the block ends.

    Args:
        path: Of the file; its name must end in .mp4 or .webp.
        size: Width and height of all pictures, even numbers of pixels.
        fps: Pictures a second.

    Raises:
        OutputError: If the file cannot be written.
    """
    kind: type[_WebpWriter | _FfmpegWriter | _OpenCvWriter]
    if path.suffix == ".webp":
        kind = _WebpWriter
    else:
        kind = _FfmpegWriter if find_spec("imageio_ffmpeg") is not None else _OpenCvWriter
    writer = kind(path, size, fps)
    try:
        yield writer
    finally:
        writer.close()


class _FfmpegWriter:
    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        from imageio_ffmpeg import write_frames  # an extra

        self._path = path
        self._sink = write_frames(str(path), size, fps=fps, codec="libx264", macro_block_size=2, quality=7)
        try:
            self._sink.send(None)
        except OSError as error:
            raise _refused(path) from error

    def add(self, picture: NDArray[np.uint8]) -> None:
        try:
            self._sink.send(np.ascontiguousarray(picture))
        except OSError as error:
            raise _refused(self._path) from error

    def close(self) -> None:
        self._sink.close()


class _OpenCvWriter:
    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        import cv2

        self._writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, size)
        if not self._writer.isOpened():
            raise _refused(path)

    def add(self, picture: NDArray[np.uint8]) -> None:
        self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def close(self) -> None:
        self._writer.release()


class _WebpWriter:
    def __init__(self, path: Path, size: tuple[int, int], fps: float) -> None:
        self._path = path
        self._size = (round(size[0] * _WEBP_SCALE), round(size[1] * _WEBP_SCALE))
        self._every = max(math.ceil(fps / _WEBP_FPS), 1)
        self._picture_ms = round(1e3 * self._every / fps)
        self._given = 0
        self._kept: list[Image.Image] = []

    def add(self, picture: NDArray[np.uint8]) -> None:
        if self._given % self._every == 0:
            self._kept.append(Image.fromarray(picture).resize(self._size, Image.Resampling.LANCZOS))
        self._given += 1

    def close(self) -> None:
        if not self._kept:
            return
        first, *others = self._kept
        try:
            first.save(
                self._path,
                save_all=True,
                append_images=others,
                duration=self._picture_ms,
                loop=0,
                quality=_WEBP_QUALITY,
                method=4,
            )
        except OSError as error:
            raise _refused(self._path) from error


def _refused(path: Path) -> OutputError:
    return OutputError(f"cannot write the video {path}; is the folder writable and the disk not full?")
