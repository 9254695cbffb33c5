"""The camera of a loop: made in the first episode, and looking at each episode's theatre."""

import numpy as np

from laploop.envs.loop.config import LoopConfig
from laploop.envs.sensors.shared_stripe_camera import SharedStripeCamera
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.theatre.theatre import Theatre
from laploop.perception.geometry import Rig


class EpisodeCamera:
    """Makes the camera when it is first needed, and keeps it from episode to episode."""

    def __init__(self, config: LoopConfig, rig: Rig, *, images: bool, depth: bool) -> None:
        """Keep what the camera is made from.

        Args:
            config: Optics, scope and device.
            rig: That of the scope.
            images: Whether each image will be asked for.
            depth: Whether each depth map will be. Where nobody asks for either, loops share one camera's buffers.
        """
        self._config = config
        self._rig = rig
        # While physics goes on, it has work for the other cores; whoever looks at the image of the moment waits for it.
        self.threads: int | None = None if images else 1
        """CPU threads of the camera once it is made; None for what the machine offers."""
        self._shared = not images and not depth
        self._camera: StripeCamera | SharedStripeCamera | None = None

    def look(self, theatre: Theatre, texture_rng: np.random.Generator) -> StripeCamera | SharedStripeCamera:
        """Return the camera as it is at the begin of an episode, attached to a theatre, whose texture `texture_rng` draws."""
        optics = self._config.optics
        if self._camera is None:
            self._camera = self._made()
        elif self._camera.optics != optics:
            # Exposure control has changed it.
            self._camera.set_optics(optics)
        appearance = theatre.config.tissue.appearance
        self._camera.attach(theatre.model, tissue=theatre.tissue, rng=texture_rng, appearance=appearance)
        return self._camera

    def close(self) -> None:
        """End the camera's threads."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None

    def _made(self) -> StripeCamera | SharedStripeCamera:
        config = self._config
        if self._shared:
            return SharedStripeCamera(config.theatre.scope, config.optics, device=config.device)
        return StripeCamera(self._rig, config.optics, device=config.device, threads=self.threads)
