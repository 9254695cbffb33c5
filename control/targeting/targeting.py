"""From a chosen pixel and depth frames to a point of the tissue, its normal and its motion."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.control.messages import ControlInput
from laploop.control.prediction.alpha_beta import AlphaBetaFilterConfig
from laploop.control.prediction.motion_predictor import MotionPredictor
from laploop.control.prediction.registry import PREDICTORS, make_predictor
from laploop.control.prediction.rhythm_predictor import RhythmPredictor, RhythmPredictorConfig
from laploop.control.targeting.sample_depth import sample_depth
from laploop.control.targeting.surface_patch import SurfacePatch, fit_even_patch
from laploop.control.targeting.tissue_motion import TissueMotion
from laploop.control.targeting.tool_occlusion import ToolOcclusion, ToolOutline
from laploop.errors import InvalidValueError
from laploop.perception.geometry import Rig, invert_transform, transform_points
from laploop.perception.messages import DepthFrame

_NEAREST_PERCENTILE = 0.5
"""Of all depths in view, what counts as the nearest; fewer pixels than that may be outliers."""


@configuration
class TargetingConfig:
    """Sizes of the neighbourhoods that `Targeting` looks at, and how the age of the depth is bridged."""

    patch_radius_m: Annotated[float, Field(ge=0.0005, le=0.05)] = 0.0045
    """Radius of the fit that gives the target point and its normal."""
    max_patch_spread_m: Annotated[float, Field(gt=0.0, le=0.1)] = 0.0004
    """Spread of the depth about that fit from which smaller ones are tried: beside a step the patch holds two surfaces."""
    min_patch_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.4
    """Fraction of the patch's pixels that must be valid and free of the tool for a frame to become the reference."""
    track_radius_m: Annotated[float, Field(ge=0.0005, le=0.05)] = 0.012
    """Radius of the neighbourhood whose median displacement stands for the target's."""
    track_points: Annotated[int, Field(ge=6, le=100_000)] = 160
    """Maximum number of points of the neighbourhood that are followed."""
    min_track_points: Annotated[int, Field(ge=6, le=100_000)] = 24
    """Minimum number of them that must be seen for a frame to count."""
    jump_speed_mps: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """A point whose depth differs from what is expected by more than tissue can move at this speed since the last measurement,
    beyond `jump_noise_m`, is rejected: a network that slips by a stripe is off by 17 mm at 60 mm and by more farther away.
    Breathing and heartbeat stay below 0.02 m/s, and tissue that an instrument pushes or lets go below 0.1 m/s."""
    jump_noise_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.004
    """Difference that the depth's own error accounts for."""
    jump_limit_m: Annotated[float, Field(gt=0.0, le=1.0)] = 0.012
    """Difference that is rejected however long the last measurement is ago: a slip that stays is no less wrong."""
    iterations: Annotated[int, Field(ge=1, le=100)] = 2
    """Passes over the displacement, which decides which pixels show the points."""
    outline: ToolOutline = Field(default_factory=ToolOutline)
    """Silhouette of the tool, whose depth is not the tissue's."""
    tracker: AlphaBetaFilterConfig = Field(default_factory=AlphaBetaFilterConfig)
    """Filter of the measured displacement."""
    prediction: str = "rate"
    """How the age of the depth is bridged: none (holds the newest measurement), rate (goes on at the rate measured last),
    rhythms (learns breathing and heartbeat; the rate until they can be trusted), another name, or module:Class."""
    rhythms: RhythmPredictorConfig = Field(default_factory=RhythmPredictorConfig)
    """For prediction rhythms."""
    follow_camera: bool = False
    """Whether the camera moves; where the target appears then follows from its pose at each capture. Needs
    `ControlInput.world_from_camera`."""

    def __post_init__(self) -> None:
        PREDICTORS.check(self.prediction)
        if self.patch_radius_m > self.track_radius_m:
            raise InvalidValueError("patch_radius_m", self.patch_radius_m, f"at most track_radius_m ({self.track_radius_m})")
        if self.min_track_points > self.track_points:
            raise InvalidValueError("min_track_points", self.min_track_points, f"at most track_points ({self.track_points})")

    def make_predictor(self) -> MotionPredictor:
        """Return the predictor that `prediction` names.

        Raises:
            InvalidValueError: If it cannot be made.
        """
        return RhythmPredictor(self.rhythms) if self.prediction == "rhythms" else make_predictor(self.prediction)


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """What is known of the target, in the camera's frame."""

    point: Array
    """(3,), metres, where the target is now: its motion is extrapolated across the age of the depth."""
    normal: Array
    """(3,), unit, towards the camera."""
    velocity: Array
    """(3,), m/s, at the time when a command of now takes effect."""
    nearest_depth: float
    """z-depth in metres of what tissue in view lies nearest to the camera, now."""
    captured_ns: int
    """When the newest frame that showed it was captured."""
    predicted: bool = False
    """Whether point and velocity are a trusted prediction."""

    def age_ns(self, now_ns: int) -> int:
        """Return the time since the target was last seen."""
        return now_ns - self.captured_ns


class Targeting:
    """Follow the piece of tissue that was chosen by a pixel.

    The first frame that shows enough of it becomes the reference: a robust quadric under the pixel gives point and normal,
    and the points around it are kept. Tissue is taken to move along the optical axis of that frame, as on a stage or under
    breathing seen from straight above, and across it only as a marker on the target shows. In each later frame the reference
    points are moved by the displacement expected, looked up where they would then appear, and the median of what is
    missing corrects the displacement. Points that the tool covers, or that it keeps from the projector's light, do not take
    part: their depth is not the tissue's. Nor do points whose depth jumps.
    """

    def __init__(self, rig: Rig, config: TargetingConfig | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry.

        Args:
            rig: The camera and its projector.
            config: Sizes, and how the age of the depth is bridged.
            predictor: Used in place of the one that `config.prediction` names.

        Raises:
            InvalidValueError: If the predictor that is named cannot be made, or the one that is given is none.
        """
        self._rig = rig
        self._config = config = config or TargetingConfig()
        self._tool = ToolOcclusion(config.outline, np.array([[0.0, 0.0, 0.0], [rig.baseline_m, 0.0, 0.0]]))
        predictor = config.make_predictor() if predictor is None else predictor
        if not isinstance(predictor, MotionPredictor):
            raise InvalidValueError("predictor", predictor, "an object with reset, update and predict")
        self._motion = TissueMotion(config.tracker, predictor)
        self.reset()

    def reset(self) -> None:
        """Forget the target."""
        self._patch: SurfacePatch | None = None
        self._points = np.zeros((0, 3))
        self._nearest_depth = 0.0
        self._newest_ns = -1
        self._jumped_fraction = 0.0
        self._world_from_reference = np.eye(4)
        self._tool.reset()

    @property
    def reference(self) -> SurfacePatch | None:
        """The target in the frame that became the reference, or None before."""
        return self._patch

    @property
    def jumped_fraction(self) -> float:
        """Fraction of the points seen in the newest frame that were rejected, since their depth jumped."""
        return self._jumped_fraction

    def update(self, state: ControlInput) -> Target | None:
        """Take in what is known at a control tick; return the target, or None as long as no frame has shown it.

        Raises:
            InvalidValueError: If the camera is to be followed and its pose is missing, or a predictor's answer is unusable.
        """
        if self._config.follow_camera and state.world_from_camera is None:
            raise InvalidValueError("world_from_camera", None, "the camera's pose, 4x4, where the camera is followed")
        self._tool.add(state.now_ns, state.tip_in_camera)
        new = state.depth if state.depth is not None and state.depth.captured_ns > self._newest_ns else None
        if self._patch is not None:
            self._motion.work(idle=new is None)
        if new is not None:
            self._newest_ns = new.captured_ns
            if self._patch is None:
                self._adopt(new, state)
            else:
                self._follow(new, state, self._patch)
        return None if self._patch is None else self._seen_now(self._patch, state)

    def surface_at(self, pixel: Array, frame: DepthFrame, state: ControlInput) -> SurfacePatch | None:
        """Return the surface under any pixel (2,) of a frame, or None where too little of it is seen."""
        patch, _ = self._surroundings(pixel, frame, state)
        return patch

    def _seen_now(self, patch: SurfacePatch, state: ControlInput) -> Target:
        """Return the target in the camera's frame of now."""
        motion = self._motion.at(state.now_ns)
        effective = self._motion.at(state.now_ns + state.lead_ns) if state.lead_ns else motion
        target = Target(
            point=patch.point + motion.displacement,
            normal=patch.normal,
            velocity=effective.velocity,
            nearest_depth=self._nearest_depth + float(motion.displacement[2]),
            captured_ns=self._motion.measured_ns,
            predicted=motion.predicted,
        )
        if state.world_from_camera is None or not self._config.follow_camera:
            return target
        camera_from_reference = invert_transform(state.world_from_camera) @ self._world_from_reference
        rotation = camera_from_reference[:3, :3]
        point = transform_points(camera_from_reference, target.point)
        return replace(
            target,
            point=point,
            normal=rotation @ target.normal,
            velocity=rotation @ target.velocity,
            nearest_depth=float(point[2]) - (float(target.point[2]) - target.nearest_depth),
        )

    def _adopt(self, frame: DepthFrame, state: ControlInput) -> None:
        """Make a frame the reference if it shows enough of the target."""
        patch, around = self._surroundings(state.target_pixel, frame, state)
        if patch is None or len(around) < self._config.min_track_points:
            return
        self._patch = patch
        stride = max(1, -(-len(around) // self._config.track_points))
        self._points = around[::stride]
        self._motion.restart(frame.captured_ns)
        self._nearest_depth = self._nearest(frame, state)
        self._world_from_reference = frame.world_from_camera

    def _follow(self, frame: DepthFrame, state: ControlInput, patch: SurfacePatch) -> None:
        """Measure how far the tissue has moved in a frame."""
        displacement = self._measured_displacement(frame, state)
        self._motion.add(displacement, frame.captured_ns)
        if displacement is not None and state.marker_pixel is not None and np.isfinite(state.marker_pixel).all():
            marker = self._marker(frame, state.marker_pixel, patch.point[2] + displacement)
            self._motion.add_across((marker - patch.point)[:2], frame.captured_ns)

    def _reference_from_camera(self, frame: DepthFrame) -> Array:
        if not self._config.follow_camera:
            return np.eye(4)
        return invert_transform(self._world_from_reference) @ frame.world_from_camera

    def _marker(self, frame: DepthFrame, pixel: Array, depth_m: float) -> Array:
        """Return where a pixel's ray reaches a depth of the reference's camera, (3,), in that camera's frame."""
        reference_from_camera = self._reference_from_camera(frame)
        eye = reference_from_camera[:3, 3]
        ray = reference_from_camera[:3, :3] @ self._rig.camera.unproject(pixel, 1.0)
        return np.asarray(eye + (depth_m - eye[2]) / ray[2] * ray)

    def _measured_displacement(self, frame: DepthFrame, state: ControlInput) -> float | None:
        """Return how far the points have moved along the reference's optical axis, or None if too few are seen."""
        camera_from_reference = invert_transform(self._reference_from_camera(frame))
        axis = camera_from_reference[:3, 2]
        expected = self._motion.expected_at(frame.captured_ns)
        displacement = float(expected[2])
        points = transform_points(camera_from_reference, self._points + expected)
        followed = ~self._tool.hidden(points, frame.captured_ns, state.trocar_in_camera)
        followed &= ~self._jumped(points, followed, frame)
        for _ in range(self._config.iterations):
            measured, seen = sample_depth(frame, self._rig.camera, points)
            missing = (measured - points[:, 2])[seen & followed]
            if missing.size < self._config.min_track_points:
                return None
            correction = float(np.median(missing)) / float(axis[2])
            points = points + correction * axis
            displacement += correction
        return displacement

    def _jumped(self, expected: Array, in_sight: NDArray[np.bool_], frame: DepthFrame) -> NDArray[np.bool_]:
        """Return which of the points expected in the camera's frame, (n, 3), show a depth that tissue cannot have reached."""
        config = self._config
        elapsed_s = 1e-9 * (frame.captured_ns - self._motion.measured_ns)
        limit = min(config.jump_noise_m + config.jump_speed_mps * elapsed_s, config.jump_limit_m)
        measured, seen = sample_depth(frame, self._rig.camera, expected)
        jumped = np.asarray(seen & (np.abs(measured - expected[:, 2]) > limit))
        shown = seen & in_sight
        self._jumped_fraction = float(jumped[shown].mean()) if shown.any() else 0.0
        return jumped

    def _surroundings(self, pixel: Array, frame: DepthFrame, state: ControlInput) -> tuple[SurfacePatch | None, Array]:
        """Return the surface under a pixel, None if too little is seen, and the points to follow around it, (n, 3)."""
        camera, config = self._rig.camera, self._config
        ray = camera.unproject(pixel, 1.0)
        depth_m = self._depth_around(frame, pixel, 4)[0]
        if depth_m.size == 0:
            return None, np.zeros((0, 3))
        distance = float(np.median(depth_m))
        reach = int(np.ceil(camera.fx * config.track_radius_m / distance))
        depth_m, rays = self._depth_around(frame, pixel, reach)
        points = rays * depth_m[:, None]
        points = points[~self._tool.hidden(points, frame.captured_ns, state.trocar_in_camera)]
        lateral = np.hypot(points[:, 0] - ray[0] * distance, points[:, 1] - ray[1] * distance)
        core = points[lateral < config.patch_radius_m]
        full = np.pi * (camera.fx * config.patch_radius_m / distance) ** 2
        around = points[lateral < config.track_radius_m]
        if len(core) < max(6.0, config.min_patch_fraction * full):
            return None, around
        patch = fit_even_patch(core, ray, radius_m=config.patch_radius_m, max_spread_m=config.max_patch_spread_m)
        return patch, around

    def _nearest(self, frame: DepthFrame, state: ControlInput) -> float:
        """Return the depth of the nearest tissue on a coarse grid of pixels; outliers do not count."""
        coarse = (slice(2, None, 4), slice(2, None, 4))
        depth_mm, valid = frame.estimate.depth_mm[coarse], frame.estimate.valid[coarse]
        points = self._rig.camera.rays[coarse][valid] * (1e-3 * depth_mm[valid].astype(np.float64))[:, None]
        points = points[~self._tool.hidden(points, frame.captured_ns, state.trocar_in_camera)]
        return float(np.percentile(points[:, 2], _NEAREST_PERCENTILE))

    def _depth_around(self, frame: DepthFrame, pixel: Array, reach: int) -> tuple[Array, Array]:
        """Return valid depths (n,) in metres and their rays (n, 3) within `reach` pixels of a pixel."""
        camera = self._rig.camera
        column, row = int(pixel[0]), int(pixel[1])
        rows = slice(max(row - reach, 0), min(row + reach + 1, camera.height))
        columns = slice(max(column - reach, 0), min(column + reach + 1, camera.width))
        depth_mm = frame.estimate.depth_mm[rows, columns]
        valid = frame.estimate.valid[rows, columns] & (depth_mm > 0.0) & np.isfinite(depth_mm)
        return depth_mm[valid].astype(np.float64) * 1e-3, camera.rays[rows, columns][valid]
