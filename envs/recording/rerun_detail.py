"""How much of an episode a recording keeps."""

from dataclasses import dataclass
from typing import Literal, get_args

from laploop.errors import UnknownNameError

DetailName = Literal["default", "full"]


@dataclass(frozen=True, kw_only=True)
class RecordingDetail:
    """What a recording keeps of pictures, surfaces and shapes; poses and plots it keeps whole."""

    period_ns: int
    """Least simulated time between two pictures of a kind."""
    map_pixels: int
    """Pixels of the pictures of depth, truth and error along an axis, at most."""
    surface_points: int
    """Points of the reconstructed surface along an axis, at most."""
    jpeg_quality: int | None
    """Of the stripes; None keeps every grey value, as PNG."""
    tissue_tolerance_m: float
    """How far any point of the tissue may move, beyond what the whole does, before its shape is written again."""
    depth_maps: bool
    """Whether depth and truth are kept as numbers too, in every pixel."""


DETAILS = {
    # At 256x256 and 25 Hz: 8 kB of stripes, 3 x 9 kB of maps and 14 kB of surface a frame: 1.5 MB a second, and 1 MB once.
    "default": RecordingDetail(
        period_ns=40_000_000,
        map_pixels=128,
        surface_points=32,
        jpeg_quality=90,
        tissue_tolerance_m=1e-4,
        depth_maps=False,
    ),
    "full": RecordingDetail(
        period_ns=0, map_pixels=4096, surface_points=64, jpeg_quality=None, tissue_tolerance_m=0.0, depth_maps=True
    ),
}


def detail_named(name: str) -> RecordingDetail:
    """Return a detail by its name.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name not in DETAILS:
        raise UnknownNameError("detail of a recording", name, get_args(DetailName))
    return DETAILS[name]
