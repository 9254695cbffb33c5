"""One stripe camera for many scenes that are seldom looked at, so that each of them costs no picture buffers."""

import copy
import threading
from collections.abc import Collection
from typing import Any
from weakref import WeakValueDictionary

import mujoco
import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_appearance import TissueAppearance
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.envs.sensors.stripe_capture import DepthView, ExactView, StripeCapture
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.envs.sensors.tracing.scene_snapshot import SceneSnapshot
from laploop.envs.sensors.tracing.tissue_surface import TissueSurface
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig, rigid_transform


class _Buffers:
    """The camera that does the work, and whose scene it is attached to."""

    def __init__(self, scope: ScopeOptics, device: str) -> None:
        self.camera = StripeCamera(Rig.from_optics(scope), device=device, threads=1)
        self.user: object = None
        self.lock = threading.RLock()


_BUFFERS: "WeakValueDictionary[tuple[ScopeOptics, str], _Buffers]" = WeakValueDictionary()
"""Of this process, by geometry and device, for as long as a camera uses them."""
_MAKING = threading.Lock()


class SharedStripeCamera:
    """A stripe camera whose buffers are those of all of its kind in this process; one thread draws at a time.

    A scene is attached anew when it is looked at after another: some ten milliseconds, and the same bits as a camera of its
    own.
    """

    def __init__(self, scope: ScopeOptics, optics: StripeOptics, device: str = "cpu") -> None:
        """Look through a scope; `attach` a scene before the first image. Arguments and errors as for `StripeCamera`."""
        with _MAKING:
            self._buffers = _BUFFERS.get((scope, device)) or _Buffers(scope, device)
            _BUFFERS[scope, device] = self._buffers
        self._optics = optics
        self._moving: SceneGeometry | None = None
        self._attached: SceneGeometry | None = None

    @property
    def optics(self) -> StripeOptics:
        """The optical model in use."""
        return self._optics

    def set_optics(self, optics: StripeOptics) -> None:
        """Change the optical model."""
        self._optics = optics

    def attach(
        self,
        model: mujoco.MjModel,
        *,
        tissue: TissueSurface | None = None,
        groups: Collection[int] = (1,),
        rng: np.random.Generator | None = None,
        appearance: TissueAppearance | None = None,
    ) -> SceneGeometry:
        """Look at a tissue and the given groups of a model from now on; see `SceneGeometry.from_model`."""
        geometry = SceneGeometry.from_model(model, tissue=tissue, groups=groups, rng=rng, appearance=appearance)
        # The tree that rays descend depends on where the points were when it was built.
        self._attached = copy.copy(geometry)
        self._attached.points = geometry.points.copy()
        self._moving = geometry
        return geometry

    def snapshot(self, data: Any, world_from_camera: NDArray[np.float64]) -> SceneSnapshot:
        """Return a copy of what moves; arguments and errors as for `RayCamera.snapshot`."""
        pose = rigid_transform("world_from_camera", world_from_camera)
        if self._moving is None:
            raise InvalidValueError("scene", None, "a scene that was attached before the first image")
        self._moving.update(data)
        return SceneSnapshot(points=self._moving.points.copy(), world_from_camera=pose)

    def depth_view(self, snapshot: SceneSnapshot) -> DepthView:
        """Return the exact depth at a moment of the attached scene."""
        with self._buffers.lock:
            return self._camera().depth_view(snapshot)

    def exact_view(self, snapshot: SceneSnapshot) -> ExactView:
        """Return the geometry at a moment of the attached scene."""
        with self._buffers.lock:
            return self._camera().exact_view(snapshot)

    def render(self, snapshot: SceneSnapshot, rng: np.random.Generator | None) -> StripeCapture:
        """Take an image of the attached scene as it was at a moment; `rng` as for `StripeCamera.capture`."""
        with self._buffers.lock:
            camera = self._camera()
            if camera.optics != self._optics:
                camera.set_optics(self._optics)
            capture = camera.render(snapshot, rng)
            # Exposure control changes it.
            self._optics = camera.optics
            return capture

    def close(self) -> None:
        """Leave the buffers to others; the camera stays usable."""
        with self._buffers.lock:
            if self._buffers.user is self._attached:
                self._buffers.user = None

    def _camera(self) -> StripeCamera:
        """Return the camera, attached to this one's scene."""
        buffers = self._buffers
        if buffers.user is not self._attached and self._attached is not None:
            buffers.camera.attach_geometry(self._attached)
            buffers.user = self._attached
        return buffers.camera
