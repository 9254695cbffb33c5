"""The looking task: the camera arm keeps a moving target in the middle of the view, at its working distance."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from gymnasium import spaces

from laploop.arrays import Array
from laploop.control.messages import ControlInput
from laploop.envs.tasks.configs import LookConfig
from laploop.envs.tasks.measures import Samples, nearness
from laploop.envs.tasks.observations import Observation, bounded
from laploop.envs.tasks.steppable_env import Info
from laploop.envs.tasks.task_env import TaskEnv
from laploop.perception.geometry import invert_transform, transform_points


class LookEnv(TaskEnv[LookConfig]):
    """Move the scope under its trocar so that a target stays in the middle of the image, 85 mm away.

    The target is a material point of tissue that breathes (10 mm at 0.25 Hz) while the stage travels sideways (20 mm along
    both axes at 0.08 and 0.05 Hz); it carries a marker whose pixel is known wherever it is seen. The tool arm stands still.

    ## Action and observation

    Those of `laploop.envs.tasks.actions` and `laploop.envs.tasks.observations`, except that actions move the tip of the scope,
    by at most 0.03 m/s along each axis of the camera; and

    | key | space | meaning |
    |---|---|---|
    | `marker_pixel` | `Box(-1, 256, (2,), float32)` | the marker in the frame of the newest depth map; -1 if not seen |
    | `scope_velocity` | `Box(-1, 1, (3,), float32)` | velocity of the scope's tip along the camera's axes, m/s |
    | `scope_insertion` | `Box(0, 1, (1,), float32)` | length of the scope's shaft inside the wall, m |

    ## Reward

    `centre` (minus tanh of the target's distance from the middle over a tenth of the image), `distance` (minus tanh of the
    working distance's error over 10 mm), `force`, `effort`, `success`, `harm` (`LookRewardWeights`).

    ## End

    The duration is fixed: truncated with `time` after `max_seconds`, a success if for 95 % of the time after 2 s the target
    was within 5 % of the image's width of its middle and within 5 mm of the working distance. Terminated only by harm:
    `force` above 5 N on the tool's tip, `rcm` above 5 mm.

    ## Info

    Besides the keys of every task: `centre_share` (distance from the middle over the image's width), `distance_error_mm`
    (signed, positive too far away), `in_view`.
    """

    config_type: ClassVar[type[LookConfig]] = LookConfig
    moves_scope: ClassVar[bool] = True

    def extra_spaces(self) -> dict[str, spaces.Box]:
        """Return the spaces of the marker and of the scope's own state."""
        camera = self.loop.rig.camera
        return {
            "marker_pixel": spaces.Box(-1.0, float(max(camera.width, camera.height)), (2,), np.float32),
            "scope_velocity": spaces.Box(-1.0, 1.0, (3,), np.float32),
            "scope_insertion": spaces.Box(0.0, 1.0, (1,), np.float32),
        }

    def extra_observation(self) -> Observation:
        """Return the marker and the scope's own state."""
        marker = self.loop.marker_pixel() if self.config.marker else None
        rotation = self.loop.scope.world_from_camera()[:3, :3]
        return {
            "marker_pixel": np.full(2, -1.0, np.float32) if marker is None else marker.astype(np.float32),
            "scope_velocity": bounded(rotation.T @ self.loop.scope.shaft_tip_velocity_in_world(), -1.0, 1.0),
            "scope_insertion": bounded([self.loop.scope_insertion_m], 0.0, 1.0),
        }

    def control_input(self) -> ControlInput:
        """Return everything that a tip controller may know now, the working distance included."""
        return replace(super().control_input(), working_distance_m=self.config.working_distance_m)

    def target_error_mm(self) -> float:
        """Return the distance of the target from where it should be in the camera's frame."""
        return float(np.linalg.norm(self._target_in_camera() - [0.0, 0.0, self.config.working_distance_m])) * 1e3

    def measure(self, *, begin: bool) -> None:
        """Measure where the target is in the view."""
        config, camera = self.config, self.loop.rig.camera
        target = self._target_in_camera()
        self._error_mm = self.target_error_mm()
        self._distance_error_mm = float(target[2] - config.working_distance_m) * 1e3
        off = camera.project(target) - [camera.cx, camera.cy]
        self._centre_share = float(np.linalg.norm(off)) / camera.width
        self._in_view = bool((np.abs(off) <= [0.5 * camera.width, 0.5 * camera.height]).all())
        if begin:
            self._centre, self._distance, self._held = Samples(), Samples(), Samples()
        elif self.is_assessed():
            off_mm = abs(self._distance_error_mm)
            self._centre.add(self._centre_share)
            self._distance.add(off_mm)
            self._held.add(float(self._centre_share <= config.max_centre_share and off_mm <= config.max_distance_error_m * 1e3))

    def is_assessed(self) -> bool:
        """Return whether the settling time is over."""
        return self.loop.now_ns > round(self.config.settle_s * 1e9)

    def solved_in_time(self) -> bool:
        """Return whether the target was in its place for long enough."""
        share = self._held.mean()
        return share is not None and share >= self.config.hold_share

    def reward_terms(self) -> dict[str, float]:
        """Return the distance from the middle of the view, and the error of the working distance."""
        return {"centre": nearness(self._centre_share, 0.1), "distance": nearness(abs(self._distance_error_mm), 10.0)}

    def task_info(self) -> Info:
        """Return the target's place in the view."""
        return {
            "target_error_mm": self._error_mm,
            "centre_share": self._centre_share,
            "distance_error_mm": self._distance_error_mm,
            "in_view": self._in_view,
        }

    def metrics(self) -> dict[str, float | None]:
        """Return where the target was after the settling time."""
        return {
            "held_share": self._held.mean(),
            "centre_share_p95": self._centre.percentile(95),
            "centre_share_max": self._centre.largest(),
            "distance_error_p95_mm": self._distance.percentile(95),
            "distance_error_max_mm": self._distance.largest(),
        }

    def _target_in_camera(self) -> Array:
        return transform_points(invert_transform(self.loop.theatre.world_from_camera()), self.target_in_world())
