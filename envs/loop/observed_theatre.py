"""A theatre and the camera that looks at it: what an episode builds, and what a state finds again by a seed."""

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from laploop.envs.loop.config import LoopConfig
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.shared_stripe_camera import SharedStripeCamera
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.theatre.theatre import Theatre, TheatreState
from laploop.errors import SimulationError
from laploop.perception.geometry import Rig


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneState:
    """A theatre at a moment, as what it was made from and what has changed since."""

    seed: int
    texture_rng: np.random.Generator
    """As it was before it drew the tissue's texture."""
    theatre: TheatreState
    optics: StripeOptics
    """Of the camera; exposure control changes them."""


class ObservedTheatre:
    """Builds a theatre an episode, and one camera, made in the first episode, for all of them.

    Attributes:
        theatre: That of the episode.
        camera: Attached to it.
    """

    def __init__(self, config: LoopConfig, rig: Rig, *, images: bool, depth: bool) -> None:
        """Keep what theatres and camera are made from.

        Args:
            config: Theatre, optics and device.
            rig: That of the scope.
            images: Whether each image will be asked for.
            depth: Whether each depth map will be. Where nobody asks for either, loops share one camera's buffers.
        """
        self._config = config
        self._rig = rig
        self._shares = not images and not depth
        # While physics goes on, it has work for the other cores; whoever looks at the image of the moment waits for it.
        self.threads: int | None = None if images else 1
        """CPU threads of the camera once it is made; None for what the machine offers."""
        self.camera: StripeCamera | SharedStripeCamera | None = None
        self.theatre: Theatre | None = None
        self._texture_rng: np.random.Generator | None = None

    def build(self, seed: int) -> Theatre:
        """Build the theatre of a seed, unless its configuration decides."""
        self._seed = seed
        self._texture_rng = None
        self.theatre = Theatre(self._config.theatre, self._config, seed=seed)
        return self.theatre

    def look(self, texture_rng: np.random.Generator) -> StripeCamera | SharedStripeCamera:
        """Return the camera as it is at the begin of an episode, attached to the theatre, whose texture `texture_rng` draws.

        Raises:
            SimulationError: If no theatre has been built.
        """
        if (theatre := self.theatre) is None:
            raise SimulationError("there is no theatre to look at; build one first")
        optics = self._config.optics
        if self.camera is None:
            self.camera = self._made_camera()
        elif self.camera.optics != optics:
            # Exposure control has changed it.
            self.camera.set_optics(optics)
        self._texture_rng = copy.deepcopy(texture_rng)
        appearance = theatre.config.tissue.appearance
        self.camera.attach(theatre.model, tissue=theatre.tissue, rng=texture_rng, appearance=appearance)
        return self.camera

    def parts(self) -> dict[str, Any]:
        """Return the objects to which a state refers by name; empty before the first episode."""
        if (theatre := self.theatre) is None or self.camera is None:
            return {}
        return {
            "theatre": theatre,
            "theatre.model": theatre.model,
            "theatre.data": theatre.data,
            "theatre.tissue": theatre.tissue,
            "theatre.camera_arm": theatre.camera_arm,
            "theatre.tool_arm": theatre.tool_arm,
            "camera": self.camera,
        }

    def get_state(self) -> SceneState | None:
        """Return the scene as it is, or None before the first episode; no image may be under way."""
        if self.theatre is None or self.camera is None or self._texture_rng is None:
            return None
        return SceneState(
            seed=self._seed,
            texture_rng=copy.deepcopy(self._texture_rng),
            theatre=self.theatre.get_state(),
            optics=self.camera.optics,
        )

    def set_state(self, state: SceneState) -> Theatre:
        """Take over what `get_state` has returned; return the theatre, which is a new one unless it had that seed."""
        theatre, camera, drawn = self.theatre, self.camera, self._texture_rng
        same_texture = drawn is not None and drawn.bit_generator.state == state.texture_rng.bit_generator.state
        if theatre is None or camera is None or self._seed != state.seed or not same_texture:
            theatre = self.build(state.seed)
            camera = self.look(copy.deepcopy(state.texture_rng))
        theatre.set_state(state.theatre)
        if camera.optics != state.optics:
            camera.set_optics(state.optics)
        return theatre

    def close(self) -> None:
        """End the camera's threads."""
        if self.camera is not None:
            self.camera.close()
            self.camera = None

    def _made_camera(self) -> StripeCamera | SharedStripeCamera:
        config = self._config
        if self._shares:
            return SharedStripeCamera(config.theatre.scope, config.optics, device=config.device)
        return StripeCamera(self._rig, config.optics, device=config.device, threads=self.threads)
