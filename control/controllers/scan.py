"""Following a path on the tissue at a constant stand-off."""

from dataclasses import replace
from typing import Annotated

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.controllers.approach_geometry import ApproachGeometry
from laploop.control.controllers.hover import HoverController, HoverControllerConfig
from laploop.control.controllers.phase import Phase
from laploop.control.controllers.scan_path import ScanPath
from laploop.control.messages import ControlInput
from laploop.control.targeting.targeting import Target
from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthFrame


@configuration
class ScanControllerConfig(HoverControllerConfig):
    """Distances and speeds of `ScanController`."""

    scan_speed_mps: Annotated[float, Field(gt=0.0, le=0.2)] = 0.008
    """Speed along the path, relative to the tissue."""
    full_speed_error_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.0005
    """Error up to which the scan goes on at full speed."""
    waiting_error_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.002
    """Error from which on it waits for the tip."""
    overrun_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.002
    """Distance it goes on beyond the end. A normal 10 degrees off puts a tip at the stand-off 0.8 mm off along the path;
    without going on, the last of the path might then never be under the tip."""
    min_seen_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.8
    """Fraction of the path's pixels that a frame must show for the path to be laid."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.full_speed_error_m < self.waiting_error_m:
            allowed = f"above full_speed_error_m ({self.full_speed_error_m})"
            raise InvalidValueError("waiting_error_m", self.waiting_error_m, allowed)


class ScanController(HoverController[ScanControllerConfig]):
    """A `TipController` that leads the ball end along a path at a stand-off over the surface.

    The first frame that shows target and path lays the path onto the surface, with a robust fit under each of its pixels;
    newer frames move it with the tissue. The tip stays on the normal through the foot on the path. The shaft's own direction
    is not free under a trocar: tip and trocar fix it.
    """

    config_class = ScanControllerConfig

    @property
    def progress(self) -> float:
        """Fraction of the path that is behind."""
        return 0.0 if self._path is None else min(1.0, self._along / self._path.length_m)

    def reset(self) -> None:
        """Forget everything; a new episode begins."""
        super().reset()
        self._path: ScanPath | None = None
        self._tried_ns = -1
        self._along = 0.0

    def command(self, state: ControlInput) -> Array:
        """Return the desired tip velocity (3,) in m/s in the camera's frame.

        Raises:
            InvalidValueError: If there is no path, or one of other than two or more finite pixels.
        """
        self._pixels = _checked(state.path_pixels)
        return super().command(state)

    def _aim(self, state: ControlInput) -> Target | None:
        """Return the place on the path where the scan is, moved as the tissue around the target has."""
        seen = self._lay(state) if self._path is None else self._targeting.update(state)
        reference = self._targeting.reference
        if seen is None or self._path is None or reference is None:
            return None
        point, normal = self._path.place(self._along)
        return replace(seen, point=point + (seen.point - reference.point), normal=normal)

    def _lay(self, state: ControlInput) -> Target | None:
        """Lay the path in a frame that has not been tried; return the target of that frame."""
        frame = state.depth
        if frame is None or frame.captured_ns <= self._tried_ns:
            return None
        self._tried_ns = frame.captured_ns
        self._targeting.reset()
        seen = self._targeting.update(state)
        if seen is not None:
            self._path = self._laid(frame, state)
        return seen

    def _laid(self, frame: DepthFrame, state: ControlInput) -> ScanPath | None:
        patches = [self._targeting.surface_at(pixel, frame, state) for pixel in self._pixels]
        found = [patch for patch in patches if patch is not None]
        if len(found) < max(2.0, self._config.min_seen_fraction * len(self._pixels)):
            return None
        return ScanPath(found)

    def _work(self, state: ControlInput, geometry: ApproachGeometry, elapsed: float) -> Array:
        config = self._config
        if self._phase is None:
            self._phase = Phase.LOWER
            self._begin(state, geometry)
        velocity, way = self._sink(state, geometry, elapsed)
        error = float(np.linalg.norm(way))
        if self._phase is Phase.LOWER and self._height <= config.standoff_m and error < config.full_speed_error_m:
            self._phase = Phase.SCAN
        if self._phase is Phase.SCAN and self._path is not None:
            velocity = velocity + self._go_on(self._path, error, elapsed)
        return velocity + config.approach.motion.back(way, lead_ns=state.lead_ns)

    def _go_on(self, path: ScanPath, error: float, elapsed: float) -> Array:
        """Move the foot along the path, the slower the larger the error; return the velocity (3,) that this gives the tip."""
        config = self._config
        fraction = (config.waiting_error_m - error) / (config.waiting_error_m - config.full_speed_error_m)
        speed = config.scan_speed_mps * min(max(fraction, 0.0), 1.0)
        height = config.approach.distances.shaft.tip_radius_m + self._height
        ahead = path.above(self._along + 0.001, height) - path.above(self._along, height)
        end = path.length_m + config.overrun_m
        self._along = min(self._along + speed * elapsed, end)
        if self._along >= end:
            self._phase = Phase.DONE
        return 1e3 * speed * ahead


def _checked(pixels: Array | None) -> Array:
    if pixels is None or pixels.ndim != 2 or pixels.shape[1] != 2 or len(pixels) < 2 or not np.isfinite(pixels).all():
        shown = None if pixels is None else pixels.tolist()
        raise InvalidValueError("path_pixels", shown, "2 or more finite pixels (u, v) in the first frame")
    return pixels
