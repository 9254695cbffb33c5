"""What the camera sees, rendered while physics goes on."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from laploop.arrays import Array
from laploop.envs.loop.background import BackgroundWorker, Pending
from laploop.envs.loop.stage_timer import StageTimer
from laploop.envs.sensors.shared_stripe_camera import SharedStripeCamera
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.stripe_capture import DepthView, ExactView, StripeCapture


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameView:
    """What the camera saw at one moment, in three degrees of detail; nothing is rendered before it is asked for or begun."""

    only_depth: Pending[DepthView]
    only_geometry: Pending[ExactView]
    whole: Pending[StripeCapture]
    """The image, with all the rest."""

    @property
    def geometry(self) -> Pending[ExactView] | Pending[StripeCapture]:
        """The exact geometry, from a whole capture where that is what is under way."""
        return self.whole if self.whole.begun and not self.only_geometry.begun else self.only_geometry

    @property
    def depth(self) -> Pending[DepthView] | Pending[ExactView] | Pending[StripeCapture]:
        """The exact depth, from more than that where it is under way."""
        return self.geometry if self.geometry.begun else self.only_depth


class FrameRenderer:
    """Renders one episode's frames on a background thread, each from a copy of what moves.

    Each frame has noise of its own, so that an image does not depend on when, or whether, others are rendered. Under exposure
    control it does: there all of them are, in their order.
    """

    def __init__(self, camera: StripeCamera | SharedStripeCamera, noise_rng: np.random.Generator, timer: StageTimer) -> None:
        """Render what the camera, attached to its scene, is shown; times go to the timer as `render`."""
        self._camera = camera
        self._noise_rng = noise_rng
        self._each_follows = camera.optics.exposure_control.gain > 0.0
        self._worker = BackgroundWorker("render", timer)

    def take(self, data: Any, world_from_camera: Array) -> FrameView:
        """Keep what the camera sees now: the state of the model, its kinematics current, and the camera's pose, 4x4."""
        camera, later = self._camera, self._worker.later
        snapshot = camera.snapshot(data, world_from_camera)
        (noise,) = self._noise_rng.spawn(1)
        view = FrameView(
            only_depth=later(partial(camera.depth_view, snapshot)),
            only_geometry=later(partial(camera.exact_view, snapshot)),
            whole=later(partial(camera.render, snapshot, noise)),
        )
        if self._each_follows:
            view.whole.begin()
        return view

    def abandon(self) -> None:
        """Begin nothing any more; does not wait for what is under way."""
        self._worker.abandon()

    def settle(self) -> None:
        """Wait for what is under way, and go on."""
        self._worker.settle()

    def close(self) -> None:
        """End the thread; what has not been rendered cannot be any more."""
        self._worker.close()
