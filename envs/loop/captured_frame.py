"""A frame under way from the camera to perception, and what only the simulator knows about it."""

from functools import cached_property

import numpy as np

from laploop.arrays import Array
from laploop.envs.loop.frame_renderer import FrameView
from laploop.envs.loop.timing.log import FrameTimes
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.stripe_capture import DepthView, ExactView, StripeCapture
from laploop.perception.geometry import Intrinsics, invert_transform, transform_points
from laploop.perception.messages import StripeFrame

_COVERED_MM = 3.0
"""A point so far behind what its pixel shows is not seen."""


class CapturedFrame:
    """A frame, whose image and truth are rendered in the background, or when they are asked for."""

    def __init__(
        self,
        *,
        index: int,
        captured_ns: int,
        available_ns: int,
        world_from_camera: Array,
        true_pose: Array,
        view: FrameView,
        time_stamp_offset_ns: int = 0,
    ) -> None:
        """Take what is known at the capture.

        Args:
            index: Of the frame in its episode.
            captured_ns: Simulated time of the capture.
            available_ns: Simulated time of its arrival at perception.
            world_from_camera: 4x4, by the kinematics of the camera arm.
            true_pose: The same as it really is.
            view: What the camera sees.
            time_stamp_offset_ns: By how much the time stamp that consumers are given is too late.
        """
        self.times = FrameTimes(index=index, captured_ns=captured_ns)
        self.index = index
        self.captured_ns = captured_ns
        self.available_ns = available_ns
        # No consumer would take a frame from the future.
        self.time_stamp_ns = min(captured_ns + time_stamp_offset_ns, available_ns)
        self.world_from_camera = world_from_camera
        self.view = view
        self._true_pose = true_pose
        self._target_in_world: Array | None = None

    @cached_property
    def frame(self) -> StripeFrame:
        """The frame as perception gets it."""
        return StripeFrame(
            index=self.index,
            image=self.truth.image,
            captured_ns=self.time_stamp_ns,
            available_ns=self.available_ns,
            world_from_camera=self.world_from_camera,
        )

    @property
    def truth(self) -> StripeCapture:
        """The image with the exact geometry behind it."""
        return self.view.whole.wait()

    @property
    def geometry(self) -> ExactView:
        """The exact geometry; costs less than `truth` where no image is asked for."""
        return self.view.geometry.wait()

    @property
    def depth(self) -> DepthView:
        """The exact depth and what each pixel shows; costs least."""
        return self.view.depth.wait()

    def mark(self, target_in_world: Array) -> None:
        """Take note of where the target is, (3,), at the capture."""
        self._target_in_world = target_in_world

    def marker_pixel(self, camera: Intrinsics) -> Array | None:
        """Return where the target appears, (2,), or None where it is out of view or covered, or nobody took note of it."""
        if self._target_in_world is None:
            return None
        point = transform_points(invert_transform(self._true_pose), self._target_in_world)
        if point[2] <= 0.0:
            return None
        pixel = camera.project(point)
        column, row = int(np.floor(pixel[0])), int(np.floor(pixel[1]))
        if not (0 <= column < camera.width and 0 <= row < camera.height):
            return None
        # Deeper than what the pixel shows by more than the tissue's slope explains: something is in front of it.
        seen = self.depth
        covered = seen.object_id[row, column] != ObjectId.TISSUE
        covered = covered or point[2] * 1e3 - float(seen.depth_mm[row, column]) > _COVERED_MM
        return None if covered else pixel
