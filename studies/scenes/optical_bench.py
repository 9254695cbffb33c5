"""The paper's bench: the scope looks straight down, the reference camera from the side, at what the stage moves."""

from dataclasses import field, replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import Field, configuration
from laploop.envs.sensors.optics.presets import PresetName, optics_preset
from laploop.envs.sensors.optics.stripe_optics import StripeOptics
from laploop.envs.sensors.reference.optics import ReferenceOptics, Sampling
from laploop.errors import check_range
from laploop.perception.geometry import Rig, invert_transform

if TYPE_CHECKING:
    from laploop.envs.sensors.reference.camera import ReferenceCamera
    from laploop.envs.sensors.stripe_camera import StripeCamera

Array = NDArray[np.float64]


def _full_sampling() -> ReferenceOptics:
    return ReferenceOptics(sampling="full")


@configuration
class OpticalBench:
    """Two cameras that are fixed to a table; tissue and calibration board move on a stage below them.

    World: z up, metres, origin on the scope's axis, `nominal_distance_m` in front of the scope: a surface at height h has the
    depth `nominal_distance_m - h`.
    """

    scope: ScopeOptics = field(default_factory=ScopeOptics)
    preset: PresetName = "paper"
    """Optical model of the scope."""
    reference: ReferenceOptics = field(default_factory=_full_sampling)
    nominal_distance_m: Annotated[float, Field(ge=0.03, le=0.3)] = 0.095
    """From the scope to the world's origin: the middle of the paper's working range."""
    reference_distance_m: Annotated[float, Field(ge=0.1, le=10.0)] = 0.6
    """From the reference camera to the world's origin."""

    def __post_init__(self) -> None:
        check_range("reference_distance_m", self.reference_distance_m, self.reference.near_m, self.reference.far_m)

    @property
    def optics(self) -> StripeOptics:
        """The optical model that `preset` names."""
        return optics_preset(self.preset)

    @property
    def world_from_scope(self) -> Array:
        """Pose of the scope's camera channel, 4x4; it looks down the world's z axis, its x axis along the world's."""
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = self.nominal_distance_m
        return pose

    @property
    def world_from_reference(self) -> Array:
        """Pose of the reference camera, 4x4: on the world's -y side, looking at the origin."""
        from laploop.envs.sensors.reference.camera import lateral_mount  # loads Warp

        return lateral_mount([0.0, 0.0, 0.0], distance_m=self.reference_distance_m)

    @property
    def scope_from_reference(self) -> Array:
        """The true transform between the two cameras, 4x4, which is unknown on a real bench."""
        return invert_transform(self.world_from_scope) @ self.world_from_reference

    @property
    def rig(self) -> Rig:
        """Camera and projector channel of the scope."""
        return Rig.from_optics(self.scope)

    def scope_camera(self, *, clear_mask: bool = False, threads: int | None = None) -> "StripeCamera":
        """Make the scope's camera, to attach a scene to; with a clear mask, a window replaces the stripes for even light."""
        from laploop.envs.sensors.stripe_camera import StripeCamera  # loads Warp

        scope = (
            replace(self.scope, mask=StripeMask(profile=(1.0,), fov_rad=self.scope.mask.fov_rad)) if clear_mask else self.scope
        )
        return StripeCamera(Rig.from_optics(scope), self.optics, threads=threads)

    def reference_camera(self, *, sampling: Sampling | None = None, threads: int | None = None) -> "ReferenceCamera":
        """Make the reference camera, at the bench's sampling or another; attach a scene to it."""
        from laploop.envs.sensors.reference.camera import ReferenceCamera  # loads Warp

        optics = self.reference if sampling is None else replace(self.reference, sampling=sampling)
        return ReferenceCamera(optics, threads=threads)
