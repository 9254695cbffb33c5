"""One frame from a camera into a data set."""

from typing import Any

import numpy as np

from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.data.frame_store import FrameStore
from laploop.studies.scenes.frame_conditions import CameraPose
from laploop.studies.scenes.hard_conditions import ill_exposure
from laploop.studies.scenes.unshaded import unshaded_image
from laploop.studies.synthesis.config import TrainingFramesConfig

_ILL_EXPOSED_FRACTIONS = (0.1, 0.5)


def write_frame(
    config: TrainingFramesConfig,
    store: FrameStore,
    index: int,
    camera: StripeCamera,
    data: Any,
    pose: CameraPose,
    rng: np.random.Generator,
) -> None:
    """Take a frame with the camera's optics and write it: ill exposed, or without shading, if so drawn.

    `data` as for `StripeCamera.capture`.
    """
    optics = camera.optics
    # An option that is off draws no numbers, so that the frames of a seed do not depend on it.
    if config.ill_exposed_share > 0.0 and rng.random() < config.ill_exposed_share:
        expected = camera.capture(data, pose.world_from_camera, None).electrons
        fraction = rng.uniform(*_ILL_EXPOSED_FRACTIONS)
        camera.set_optics(ill_exposure(expected, optics, fraction, saturated=index % 2 == 0))
    unshaded = config.unshaded_share > 0.0 and rng.random() < config.unshaded_share
    frame = camera.capture(data, pose.world_from_camera, rng)
    image = unshaded_image(camera, data, pose.world_from_camera, rng) if unshaded else frame.image
    store.write(index, image=image, depth_mm=frame.depth_mm, lit=frame.lit)
