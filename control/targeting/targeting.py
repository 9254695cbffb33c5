"""From a chosen pixel and depth frames to a point of the tissue, its normal and its motion."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from laploop.control.messages import ControlInput
from laploop.control.prediction.alpha_beta import AlphaBetaFilter, AlphaBetaFilterConfig
from laploop.control.prediction.motion_predictor import MotionPredictor, RhythmPredictor, RhythmPredictorConfig
from laploop.control.targeting.depth_sampler import DepthSampler
from laploop.control.targeting.frame_prediction import FramePrediction
from laploop.control.targeting.surface_patch import SurfacePatch, fit_patch
from laploop.control.targeting.tool_occlusion import ToolOutline, hidden_by_tool
from laploop.control.vectors import is_finite
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception.geometry import Rig, invert_transform, transform_points
from laploop.perception.messages import DepthFrame

Array = NDArray[np.float64]

PredictionName = Literal["none", "rate", "rhythms"]
"""How the age of the depth is bridged, in the order of what it takes."""

_NEAREST_PERCENTILE = 0.5
"""Of all depths in view, what counts as the nearest; fewer pixels than that may be outliers."""

_HISTORY_TICKS = 128
"""Remembered poses of the tool: one second at 125 Hz, more than the age of any frame worth using."""


@dataclass(frozen=True, kw_only=True)
class TargetingConfig:
    """Sizes of the neighbourhoods that `Targeting` looks at."""

    patch_radius_m: float = 0.0045
    """Of the fit that gives the target point and its normal."""
    min_patch_fraction: float = 0.4
    """Share of the patch's pixels that must be valid and free of the tool for a frame to become the reference."""
    track_radius_m: float = 0.012
    """Of the neighbourhood whose median displacement stands for the target's."""
    track_points: int = 160
    """So many points of the neighbourhood are followed, at most."""
    min_track_points: int = 24
    """So many of them must be seen for a frame to count."""
    iterations: int = 2
    """Of the displacement, which decides which pixels show the points."""
    outline: ToolOutline = field(default_factory=ToolOutline)
    tracker: AlphaBetaFilterConfig = field(default_factory=AlphaBetaFilterConfig)
    prediction: PredictionName = "rate"
    """`none` holds the newest measurement; `rate` goes on at the rate seen last; `rhythms` learns breathing and heartbeat and
    takes what they say as soon as it can be trusted, the rate until then."""
    rhythms: RhythmPredictorConfig = field(default_factory=RhythmPredictorConfig)
    follow_camera: bool = False
    """Whether the camera moves: its pose at each capture then tells where the target must appear. Needs
    `ControlInput.world_from_camera`."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            UnknownNameError: If there is no such prediction.
            InvalidValueError: If a field lies outside its range.
        """
        if self.prediction not in get_args(PredictionName):
            raise UnknownNameError("prediction", self.prediction, get_args(PredictionName))
        if not 0.0005 <= self.patch_radius_m <= self.track_radius_m <= 0.05:
            raise InvalidValueError(
                "patch_radius_m and track_radius_m",
                (self.patch_radius_m, self.track_radius_m),
                "0.0005 <= patch <= track <= 0.05 m",
            )
        if not 0.0 < self.min_patch_fraction <= 1.0:
            raise InvalidValueError("min_patch_fraction", self.min_patch_fraction, "above 0 and at most 1")
        if not 6 <= self.min_track_points <= self.track_points:
            raise InvalidValueError(
                "min_track_points and track_points", (self.min_track_points, self.track_points), "6 <= min <= points"
            )
        if self.iterations < 1:
            raise InvalidValueError("iterations", self.iterations, "an integer from 1")


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
    """Whether point and velocity are a trusted prediction from the rhythms of the motion."""

    def age_ns(self, now_ns: int) -> int:
        """Time since the target was last seen."""
        return now_ns - self.captured_ns


class Targeting:
    """Follow the piece of tissue that was chosen by a pixel.

    The first frame that shows enough of it becomes the reference: a robust quadric under the pixel gives point and normal,
    and the points around it are kept. Tissue is taken to move along the optical axis of that frame, as on a stage or under
    breathing seen from straight above, and across it only as a marker on the target tells. In each later frame the reference
    points are moved by the displacement assumed so far, looked up where they would then appear, and the median of what is
    missing corrects the displacement. Points that the tool covers, or that it keeps from the projector's light, do not take
    part: their depth is not the tissue's.
    """

    def __init__(self, rig: Rig, config: TargetingConfig | None = None, predictor: MotionPredictor | None = None) -> None:
        """Take the camera's geometry.

        Args:
            rig: The camera and its projector.
            config: Sizes, and how the age of the depth is bridged.
            predictor: Used in place of the one that `config.prediction` names; believed where it says that it is trusted.
                If it has `work` as `motion_predictor.BackgroundWork` says, that is called in ticks without anything new.
        """
        self._rig = rig
        self._config = config = config or TargetingConfig()
        self._eyes = np.array([[0.0, 0.0, 0.0], [rig.baseline_m, 0.0, 0.0]])
        self._sampler = DepthSampler(rig)
        if predictor is None and config.prediction == "rhythms":
            predictor = RhythmPredictor(config.rhythms)
        self._predictor = predictor
        self._work: Callable[[], bool] | None = getattr(predictor, "work", None)
        self._tracker_config = config.tracker
        if config.prediction == "none":
            self._tracker_config = replace(config.tracker, alpha=1.0, beta=0.0, max_extrapolation_s=0.0)
        self.reset()

    def reset(self) -> None:
        """Forget the target."""
        self._patch: SurfacePatch | None = None
        self._points = np.zeros((3, 0))
        self._nearest_depth = 0.0
        self._tracker = AlphaBetaFilter(self._tracker_config, 0)
        if self._predictor is not None:
            self._predictor.reset()
        self._newest_ns = -1
        self._due_ns: int | None = None
        self._expected: FramePrediction | None = None
        self._untold: tuple[float | None, int] | None = None
        self._world_from_reference = np.eye(4)
        self._sideways = tuple(AlphaBetaFilter(self._tracker_config, 0) for _ in range(2))
        self._poses: deque[tuple[int, Array]] = deque(maxlen=_HISTORY_TICKS)

    def update(self, state: ControlInput) -> Target | None:
        """Take in what is known at a control tick; return the target, or None as long as no frame has shown it.

        Raises:
            InvalidValueError: If the camera is to be followed and its pose is missing.
        """
        if self._config.follow_camera and state.world_from_camera is None:
            raise InvalidValueError("world_from_camera", None, "the camera's pose, 4x4, where the camera is followed")
        if is_finite(state.tip_in_camera):
            self._poses.append((state.now_ns, state.tip_in_camera))
        frame = state.depth
        new = frame is not None and frame.captured_ns > self._newest_ns
        # One heavy thing a tick where frames come seldom enough: to measure, to learn from it, to work in the background, or to
        # get ready for the next frame.
        if self._untold is not None:
            self._teach_predictor()
        elif not new and not (self._work is not None and self._work()) and self._due_ns is not None:
            self._get_ready(self._due_ns, state)
        if frame is not None and new:
            if self._patch is None:
                self._adopt(frame, state)
            else:
                self._follow(frame, state)
            # Frames come at a rate of their own. What a moving camera will see of the points takes its pose to know.
            known = self._patch is not None and self._newest_ns >= 0 and not self._config.follow_camera
            self._due_ns = 2 * frame.captured_ns - self._newest_ns if known else None
            self._expected = None
            self._newest_ns = frame.captured_ns
        if self._patch is None:
            return None
        moved, rate, predicted = self._motion(state.now_ns)
        effective_ns = state.now_ns + state.lead_ns
        if effective_ns != state.now_ns:
            _, rate, _ = self._motion(effective_ns)
        across = [one.displacement_at(state.now_ns) for one in self._sideways]
        across_rate = [one.rate_at(effective_ns) for one in self._sideways]
        target = Target(
            point=self._patch.point + np.array([*across, moved]),
            normal=self._patch.normal,
            velocity=np.array([*across_rate, rate]),
            nearest_depth=self._nearest_depth + moved,
            captured_ns=self._tracker.measured_ns,
            predicted=predicted,
        )
        return target if state.world_from_camera is None else self._seen_from(target, state.world_from_camera)

    def _motion(self, time_ns: int) -> tuple[float, float, bool]:
        """Return displacement and rate along the reference's optical axis, and whether they are a trusted prediction."""
        if self._predictor is not None:
            prediction = self._predictor.predict(time_ns)
            if prediction.trusted and math.isfinite(prediction.value) and math.isfinite(prediction.velocity):
                return prediction.value, prediction.velocity, True
        return self._tracker.displacement_at(time_ns), self._tracker.rate_at(time_ns), False

    def _seen_from(self, target: Target, world_from_camera: Array) -> Target:
        """Turn what is known in the reference frame's camera into the camera's frame of now."""
        if not self._config.follow_camera:
            return target
        camera_from_reference = invert_transform(world_from_camera) @ self._world_from_reference
        rotation = camera_from_reference[:3, :3]
        point = transform_points(camera_from_reference, target.point)
        return replace(
            target,
            point=point,
            normal=rotation @ target.normal,
            velocity=rotation @ target.velocity,
            nearest_depth=float(point[2]) - (float(target.point[2]) - target.nearest_depth),
        )

    @property
    def reference(self) -> SurfacePatch | None:
        """The target in the frame that became the reference, or None before."""
        return self._patch

    def surface_at(self, pixel: Array, frame: DepthFrame, state: ControlInput) -> SurfacePatch | None:
        """Return the surface under any pixel (2,) of a frame, or None where too little of it is seen."""
        patch, _ = self._surroundings(pixel, frame, state)
        return patch

    def _surroundings(self, pixel: Array, frame: DepthFrame, state: ControlInput) -> tuple[SurfacePatch | None, Array]:
        """Return the surface under a pixel, None if too little is seen, and the points to follow around it, (n, 3)."""
        camera = self._rig.camera
        u, v = pixel
        ray = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        depth_m = self._depth_around(frame, pixel, 4)[0]
        if depth_m.size == 0:
            return None, np.zeros((0, 3))
        distance = float(np.median(depth_m))
        reach = int(np.ceil(camera.fx * self._config.track_radius_m / distance))
        depth_m, rays = self._depth_around(frame, pixel, reach)
        points = rays * depth_m[:, None]
        points = points[~self._hidden(points, frame.captured_ns, state)]
        lateral = np.hypot(points[:, 0] - ray[0] * distance, points[:, 1] - ray[1] * distance)
        core = points[lateral < self._config.patch_radius_m]
        full = np.pi * (camera.fx * self._config.patch_radius_m / distance) ** 2
        around = points[lateral < self._config.track_radius_m]
        if len(core) < max(6.0, self._config.min_patch_fraction * full):
            return None, around
        return fit_patch(core, ray, radius_m=self._config.patch_radius_m), around

    def _adopt(self, frame: DepthFrame, state: ControlInput) -> None:
        patch, around = self._surroundings(state.target_pixel, frame, state)
        if patch is None or len(around) < self._config.min_track_points:
            return
        self._patch = patch
        stride = max(1, -(-len(around) // self._config.track_points))
        self._points = around[::stride].T.copy()
        self._tracker = AlphaBetaFilter(self._tracker_config, frame.captured_ns)
        self._sideways = tuple(AlphaBetaFilter(self._tracker_config, frame.captured_ns) for _ in range(2))
        if self._predictor is not None:
            self._predictor.reset()
        self._untold = 0.0, frame.captured_ns
        self._nearest_depth = self._nearest(frame, state)
        self._world_from_reference = frame.world_from_camera

    def _follow(self, frame: DepthFrame, state: ControlInput) -> None:
        displacement = self._measured_displacement(frame, state)
        if displacement is not None:
            self._tracker.update(displacement, frame.captured_ns)
        self._untold = displacement, frame.captured_ns
        if displacement is not None and state.marker_pixel is not None:
            self._follow_marker(frame, state.marker_pixel, displacement)

    def _teach_predictor(self) -> None:
        """Tell the predictor what the frame of an earlier tick showed: no tick both measures and learns."""
        if self._untold is not None and self._predictor is not None:
            self._predictor.update(*self._untold)
        self._untold = None

    def _follow_marker(self, frame: DepthFrame, pixel: Array, displacement: float) -> None:
        """Take in how far across the reference's optical axis the marker has moved, at the depth that is known."""
        if self._patch is None or not is_finite(pixel):
            return
        camera = self._rig.camera
        u, v = pixel.tolist()
        eye, ray = np.zeros(3), np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])
        if self._config.follow_camera:
            reference_from_camera = invert_transform(self._world_from_reference) @ frame.world_from_camera
            eye, ray = reference_from_camera[:3, 3], reference_from_camera[:3, :3] @ ray
        met = eye + (self._patch.point[2] + displacement - eye[2]) / ray[2] * ray
        for tracker, measured in zip(self._sideways, (met - self._patch.point).tolist(), strict=False):
            tracker.update(measured, frame.captured_ns)

    def _displacement_at(self, time_ns: int) -> Array:
        return np.array([one.displacement_at(time_ns) for one in (*self._sideways, self._tracker)])

    def _get_ready(self, due_ns: int, state: ControlInput) -> None:
        """Work out what can be known of the next frame, once it must have been captured."""
        if due_ns <= state.now_ns:
            self._expected = self._expect(due_ns, state)
            self._due_ns = None

    def _expect(self, captured_ns: int, state: ControlInput, world_from_camera: Array | None = None) -> FramePrediction:
        """Work out what of a frame's measurement does not take the frame, only the time and the pose of its capture."""
        moved = self._displacement_at(captured_ns)
        axis = np.array([0.0, 0.0, 1.0])
        points = self._points + moved[:, None]
        if world_from_camera is not None:
            camera_from_reference = invert_transform(world_from_camera) @ self._world_from_reference
            axis = camera_from_reference[:3, :3] @ axis
            points = transform_points(camera_from_reference, points.T).T.copy()
        return FramePrediction(
            captured_ns=captured_ns,
            tip=self._tip_at(captured_ns),
            trocar=state.trocar_in_camera,
            displacement=float(moved[2]),
            axis=axis,
            points=points,
            in_sight=~self._hidden(points.T, captured_ns, state),
            places=self._sampler.places(points),
        )

    def _measured_displacement(self, frame: DepthFrame, state: ControlInput) -> float | None:
        """Return how far the points have moved along the reference's optical axis, or None if too few are seen."""
        expected = self._expected
        if expected is None or not expected.holds(frame.captured_ns, self._tip_at(frame.captured_ns), state.trocar_in_camera):
            expected = self._expect(frame.captured_ns, state, frame.world_from_camera if self._config.follow_camera else None)
        points, axis, places, displacement = expected.points, expected.axis, expected.places, expected.displacement
        for iteration in range(self._config.iterations):
            if iteration:
                places = self._sampler.places(points)
            measured, seen = self._sampler.sample(frame, places)
            missing = (measured - points[2])[seen & expected.in_sight]
            if missing.size < self._config.min_track_points:
                return None
            correction = _median(missing) / float(axis[2])
            points += (correction * axis)[:, None]
            displacement += correction
        return displacement

    def _nearest(self, frame: DepthFrame, state: ControlInput) -> float:
        """Return the depth of the nearest tissue on a coarse grid of pixels; outliers do not count."""
        coarse = (slice(2, None, 4), slice(2, None, 4))
        depth_mm, valid = frame.estimate.depth_mm[coarse], frame.estimate.valid[coarse]
        points = self._rig.camera.rays[coarse][valid] * (1e-3 * depth_mm[valid].astype(np.float64))[:, None]
        points = points[~self._hidden(points, frame.captured_ns, state)]
        return float(np.percentile(points[:, 2], _NEAREST_PERCENTILE))

    def _tip_at(self, captured_ns: int) -> Array | None:
        """Return where the tool's tip was, (3,): the newest pose that is not later, else the oldest that is known."""
        before = (tip for time_ns, tip in reversed(self._poses) if time_ns <= captured_ns)
        return next(before, self._poses[0][1]) if self._poses else None

    def _hidden(self, points: Array, captured_ns: int, state: ControlInput) -> NDArray[np.bool_]:
        tip = self._tip_at(captured_ns)
        if tip is None:
            return np.zeros(len(points), dtype=bool)
        return hidden_by_tool(points, tip, state.trocar_in_camera, self._eyes, self._config.outline)

    def _depth_around(self, frame: DepthFrame, pixel: Array, reach: int) -> tuple[Array, Array]:
        """Return valid depths (n,) in metres and their rays (n, 3) within `reach` pixels of a pixel."""
        camera = self._rig.camera
        column, row = int(pixel[0]), int(pixel[1])
        rows = slice(max(row - reach, 0), min(row + reach + 1, camera.height))
        columns = slice(max(column - reach, 0), min(column + reach + 1, camera.width))
        depth_mm = frame.estimate.depth_mm[rows, columns]
        valid = frame.estimate.valid[rows, columns] & (depth_mm > 0.0) & np.isfinite(depth_mm)
        return depth_mm[valid].astype(np.float64) * 1e-3, camera.rays[rows, columns][valid]


def _median(values: Array) -> float:
    """Return the median of finite numbers, (n,), which it sorts; numpy's own takes several times as long for so few."""
    values.sort()
    middle = len(values) // 2
    return float(values[middle]) if len(values) % 2 else 0.5 * float(values[middle - 1] + values[middle])
