"""An episode as a video: what the scope sees, the depth made of it, and the theatre from outside."""

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from laploop.envs.recording.picture_colors import ColorScale, key_picture
from laploop.envs.recording.recorder import DepthRecord, FrameRecord, Recorder, TickRecord
from laploop.envs.recording.video_file import VideoWriter, video_writer
from laploop.envs.sensors.overview_camera import OverviewCamera
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.geometry import Rig

if TYPE_CHECKING:
    from laploop.envs.theatre.theatre import Theatre

_SIDE = 384
"""Pixels of each of the three pictures, along both axes."""
_CAPTION = 28
_KEY = 60
_BRIGHT = 64.0
"""Grey value that is shown as white: tissue fills the lower quarter of the sensor's range."""
_MARK = (60, 220, 90)


class VideoRecorder(Recorder):
    """Writes an MP4 file in simulated time, a picture a frame of the camera, rendered by the ray caster.

    It goes to a hidden file beside `path`, which gets its name when the recorder is closed.
    """

    def __init__(self, path: Path | str, *, camera_hz: float) -> None:
        """Check the path.

        Args:
            path: Of the video, in an existing folder; its name ends in .mp4.
            camera_hz: Frames of the camera a simulated second.

        Raises:
            InvalidValueError: If the name does not end in .mp4.
            OutputError: If the folder does not exist.
        """
        self.path = Path(path)
        if self.path.suffix != ".mp4":
            raise InvalidValueError("video", self.path, "the path of an .mp4 file")
        if not self.path.parent.is_dir():
            raise OutputError(f"cannot write {self.path}: there is no folder {self.path.parent}")
        self._partial = self.path.with_name(f".{self.path.stem}.partial.mp4")
        self._fps = camera_hz
        self._open = ExitStack()
        self._writer: VideoWriter | None = None
        self._theatre: Theatre | None = None
        self._overview: OverviewCamera | None = None
        self._scale: ColorScale | None = None
        self._depth: NDArray[np.uint8] | None = None
        self._key: NDArray[np.uint8] | None = None
        self._target: NDArray[np.float64] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def begin(self, theatre: "Theatre", rig: Rig) -> None:  # noqa: ARG002 (the recorder protocol names it)
        """Set up the view from outside, and open the hidden file."""
        self._theatre, self._overview = theatre, OverviewCamera(width=_SIDE, height=_SIDE)
        self._open.callback(self._overview.close)
        size = (3 * _SIDE, _CAPTION + _SIDE + _KEY)
        self._writer = self._open.enter_context(video_writer(self._partial, size=size, fps=self._fps))

    def tick(self, record: TickRecord) -> None:
        """Remember where the target is."""
        self._target = record.target_in_world

    def depth(self, record: DepthRecord) -> None:
        """Remember the newest depth."""
        estimate = record.depth.estimate
        depth_mm = np.where(estimate.valid, estimate.depth_mm, np.float32(np.nan))
        self._depth = _fit(self._scale_of(record.exact_depth_mm).colors(depth_mm))

    def frame(self, record: FrameRecord) -> None:
        """Write a picture."""
        if self._writer is None or self._overview is None or self._theatre is None:
            raise RuntimeError("begin() comes before any record")
        import cv2

        self._scale_of(record.exact_depth_mm)
        grey = np.clip(record.frame.image * (255.0 / _BRIGHT), 0.0, 255.0).astype(np.uint8)
        outside = np.ascontiguousarray(self._overview.picture(self._theatre))
        if self._target is not None:
            cv2.circle(outside, self._overview.pixel(self._target), 5, _MARK, 2, cv2.LINE_AA)
        unknown = np.full((_SIDE, _SIDE, 3), 128, dtype=np.uint8)
        pictures = np.hstack(
            [_fit(np.repeat(grey[..., None], 3, axis=2)), unknown if self._depth is None else self._depth, outside]
        )
        canvas = np.full((_CAPTION + _SIDE + _KEY, 3 * _SIDE, 3), 255, dtype=np.uint8)
        canvas[_CAPTION : _CAPTION + _SIDE] = pictures
        if self._key is not None:
            canvas[_CAPTION + _SIDE :, _SIDE : 2 * _SIDE] = self._key
        captions = ("scope", "estimated depth, as it has arrived", f"theatre, {record.now_ns * 1e-9:.2f} s")
        for number, text in enumerate(captions):
            place = (number * _SIDE + 8, 19)
            cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (30, 30, 30), 1, cv2.LINE_AA)
        self._writer.add(canvas)

    def close(self) -> None:
        """Finish the file and give it its name; a recorder that never began leaves nothing."""
        begun, self._writer = self._writer is not None, None
        try:
            self._open.close()
            if begun:
                self._partial.replace(self.path)
        except OSError as error:
            raise OutputError(f"cannot write {self.path}: {error.strerror or error}") from error
        finally:
            self._partial.unlink(missing_ok=True)

    def _scale_of(self, exact_depth_mm: NDArray[np.float32]) -> ColorScale:
        """Return the colours of depths, which the first frame decides."""
        if self._scale is None:
            self._scale = ColorScale.of_depths(exact_depth_mm)
            self._key = key_picture(self._scale, "z-depth [mm]", width=_SIDE, height=_KEY)
        return self._scale


def _fit(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return an RGB picture in the middle of a square of the video's size, as large as it fits."""
    import cv2

    height, width = picture.shape[:2]
    factor = _SIDE / max(height, width)
    size = (max(round(width * factor), 1), max(round(height * factor), 1))
    scaled = cv2.resize(np.ascontiguousarray(picture), size, interpolation=cv2.INTER_NEAREST)
    square = np.zeros((_SIDE, _SIDE, 3), dtype=np.uint8)
    top, left = (_SIDE - size[1]) // 2, (_SIDE - size[0]) // 2
    square[top : top + size[1], left : left + size[0]] = scaled
    return square
