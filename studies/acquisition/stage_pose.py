"""Commanded poses of the stage of an acquisition."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from laploop.studies.acquisition.config import StageRanges


@dataclass(frozen=True, kw_only=True, eq=False)
class StagePose:
    """A commanded pose of the stage."""

    working_distance_m: float
    shift_m: tuple[float, float]
    yaw_rad: float
    tilt_rad: float
    tilt_direction_rad: float
    world_from_stage: NDArray[np.float64]
    """4x4, of the middle of the stage's upper face."""


def draw_stage_pose(
    ranges: StageRanges, *, part: tuple[float, float], nominal_distance_m: float, height_m: float, rng: np.random.Generator
) -> StagePose:
    """Draw a pose whose working distance lies in a part of the range, given as fractions of it.

    The scope is `nominal_distance_m` above the world's origin. The pose turns about the tissue's middle at its mean height
    above the stage, `height_m`.
    """
    low, high = ranges.working_distance_m
    distance = low + (high - low) * float(rng.uniform(*part))
    x, y = (float(value) for value in rng.uniform(-ranges.shift_m, ranges.shift_m, size=2))
    yaw, direction = (float(value) for value in rng.uniform(-math.pi, math.pi, size=2))
    tilt = float(rng.uniform(0.0, ranges.tilt_rad))
    return StagePose(
        working_distance_m=distance,
        shift_m=(x, y),
        yaw_rad=yaw,
        tilt_rad=tilt,
        tilt_direction_rad=direction,
        world_from_stage=_pose(
            np.array([x, y, nominal_distance_m - distance]),
            (
                Rotation.from_rotvec([tilt * math.cos(direction), tilt * math.sin(direction), 0.0])
                * Rotation.from_rotvec([0.0, 0.0, yaw])
            ).as_matrix(),
            height_m,
        ),
    )


def home_pose(ranges: StageRanges, *, nominal_distance_m: float, height_m: float) -> NDArray[np.float64]:
    """Return the pose, 4x4, in which every motion starts: the middle of the range, level."""
    return _pose(np.array([0.0, 0.0, nominal_distance_m - sum(ranges.working_distance_m) / 2.0]), np.eye(3), height_m)


def _pose(middle: NDArray[np.float64], rotation: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = middle - height_m * rotation[:, 2]
    return pose
