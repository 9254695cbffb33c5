"""Messages between the stages of the loop. All times are integer nanoseconds of simulated time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError
from laploop.perception.geometry import rigid_transform


@dataclass(frozen=True, kw_only=True, eq=False)
class StripeFrame:
    """One image of the camera channel."""

    index: int
    image: NDArray[np.uint8]
    """(height, width), grey values."""
    captured_ns: int
    available_ns: int
    world_from_camera: NDArray[np.float64]
    """4x4, computer-vision camera, from the camera arm's kinematics at the time of capture."""

    def __post_init__(self) -> None:
        if not isinstance(self.image, np.ndarray) or self.image.ndim != 2 or self.image.dtype != np.uint8:
            raise InvalidValueError("image", _in_words(self.image), "an array of uint8, (height, width)")
        _check_times_and_pose(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthEstimate:
    """An estimator's depth of one image."""

    depth_mm: NDArray[np.float32]
    """(height, width), z-depth; always finite, undefined where `valid` is False."""
    valid: NDArray[np.bool_]
    """(height, width), where the estimator marks its depth valid."""
    confidence: NDArray[np.float32] | None = None
    """(height, width), probability of being within 1 mm, 0 to 1; None where the estimator has none."""
    slip: NDArray[np.float32] | None = None
    """(height, width), probability of a slip, 0 to 1: of being off by more than a tenth, or of a true depth outside the working
    range; None where the estimator has none."""

    def __post_init__(self) -> None:
        arrays: dict[str, object] = {"depth_mm": self.depth_mm, "valid": self.valid}
        for name, values in arrays.items():
            if not isinstance(values, np.ndarray):
                raise InvalidValueError(f"type of {name}", type(values).__name__, "a numpy array")
        shapes = (self.depth_mm.shape, self.valid.shape)
        if self.depth_mm.ndim != 2 or shapes[0] != shapes[1]:
            raise InvalidValueError("shape of depth_mm and valid", shapes, "two equal (height, width)")
        types = (str(self.depth_mm.dtype), str(self.valid.dtype))
        if types != ("float32", "bool"):
            raise InvalidValueError("type of depth_mm and valid", types, "float32 and bool")
        for name, probability in (("confidence", self.confidence), ("slip", self.slip)):
            if probability is not None:
                _check_probability(name, probability, shapes[0])


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthFrame:
    """A depth estimate on its way from perception to its consumers, who see it from `available_ns` on."""

    index: int
    estimate: DepthEstimate
    captured_ns: int
    available_ns: int
    world_from_camera: NDArray[np.float64]
    """4x4, as in the stripe frame that it was made from."""

    def __post_init__(self) -> None:
        if not isinstance(self.estimate, DepthEstimate):
            raise InvalidValueError("estimate", _in_words(self.estimate), "a DepthEstimate")
        _check_times_and_pose(self)

    def age_ns(self, now_ns: int) -> int:
        """Time since capture."""
        return now_ns - self.captured_ns


def _check_probability(name: str, values: NDArray[np.float32], shape: tuple[int, ...]) -> None:
    if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype != np.float32:
        raise InvalidValueError(name, _in_words(values), f"an array of float32, shape {shape}")
    # NaN fails both comparisons.
    wrong = ~np.logical_and(values >= 0.0, values <= 1.0)
    if wrong.any():
        raise InvalidValueError(name, float(values[wrong][0]), "0 to 1 at every pixel")


def _check_times_and_pose(frame: StripeFrame | DepthFrame) -> None:
    for name in ("index", "captured_ns", "available_ns"):
        value = getattr(frame, name)
        if isinstance(value, bool) or not isinstance(value, int | np.integer):
            raise InvalidValueError(name, value, "an integer")
    if frame.available_ns < frame.captured_ns:
        raise InvalidValueError("available_ns", frame.available_ns, f"captured_ns, {frame.captured_ns}, or later")
    rigid_transform("world_from_camera", frame.world_from_camera)


def _in_words(value: object) -> str:
    return f"{value.dtype}, shape {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
