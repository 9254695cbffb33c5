"""Pictures as an MP4 file."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from laploop.errors import OutputError


class VideoWriter(Protocol):
    """Takes the pictures of a video."""

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append a picture, RGB, (height, width, 3)."""


@contextmanager
def video_writer(path: Path, *, size: tuple[int, int], fps: float) -> Iterator[VideoWriter]:
    """Write an MP4 file while the block runs: H.264 where imageio-ffmpeg is installed, MPEG-4 otherwise.

    Args:
        path: Of the file; its name must end in .mp4.
        size: Width and height of all pictures, even numbers of pixels.
        fps: Pictures a second.

    Raises:
        OutputError: If the file cannot be written.
    """
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


def _refused(path: Path) -> OutputError:
    return OutputError(f"cannot write the video {path}; is the folder writable and the disk not full?")
