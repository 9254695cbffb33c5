"""The static binary stripe mask in the projection channel."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.assets.mask_pattern import LARGEST_SIDE, decode_pattern, encode_pattern
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError, check_file

_SAME_ROW = 0.02
_SQUARE = 1.05
_BRIGHT_ENOUGH = 0.05

FieldOfView = Annotated[float, Field(ge=0.02, le=3.0)]
Stripes = Annotated[int, Field(ge=1, le=200)]
Duty = Annotated[float, Field(ge=0.05, le=0.95)]
Phase = Annotated[float, Field(ge=-10.0, le=10.0)]
Transmission = Annotated[float, Field(ge=0.0, le=1.0)]


@configuration
class StripeMask:
    """Alternating opaque and transmissive stripes, parallel to the projector's y axis, or any picture.

    A position on the mask is given by the tangent coordinate `x / z` of the ray through it, in the projector's frame: dark
    and bright stripes are equidistant in it. `stripes` counts periods (one dark and one bright stripe each) across the
    field of view; 20 is the optimum that Zuo et al. (J Biomed Opt 30(8):086003, 2025) report for this kind of scope.
    """

    stripes: Stripes = 20
    """Periods across the field of view."""
    duty: Duty = 0.5
    """Width of a bright stripe as a fraction of a period."""
    phase: Phase = 0.0
    """Shift of the pattern along x, as a fraction of a period; at 0 a bright stripe starts at the left edge."""
    fov_rad: FieldOfView = math.radians(60.0)
    """Full field of view that the mask fills, along x and y."""
    edge_roughness: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Standard deviation of an edge's displacement along x, as a fraction of a period, where it varies faster along y than the
    projector resolves: the edge becomes a soft transition. Almost 0 for a photolithographic chrome mask, more for a printed
    one."""
    profile: Annotated[tuple[Transmission, ...], Field(min_length=1, max_length=16384)] | None = None
    """Transmissions of equally wide steps from the left to the right border, instead of stripes; `from_png` reads it.
    `stripes` still gives the number of periods, for decoding; `duty` and `phase` have no effect."""
    pattern: str | None = None
    """Transmission over the whole square field instead of stripes, first row at the smallest y (the top of the camera's
    image), as `mask_pattern` encodes it; `from_png` reads it. `stripes`, `duty` and `phase` as for `profile`."""
    edge_wander: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """Standard deviation of an edge's displacement along x, as a fraction of a period, where the projector resolves it: each
    edge follows its own smooth Gaussian random function of y."""
    edge_correlation: Annotated[float, Field(ge=0.05, le=10.0)] = 0.3
    """Correlation length of that displacement along y, as a fraction of a period: displacements at two heights correlate by
    exp(-(difference / length)^2 / 2)."""
    edge_seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Seed of one specimen's edges."""

    def __post_init__(self) -> None:
        if self.pattern is not None:
            decode_pattern(self.pattern)
            if self.profile is not None:
                raise InvalidValueError("profile", f"{len(self.profile)} steps beside a pattern", "a profile or a pattern")
        if self.is_drawn and self.edge_wander > 0.0:
            raise InvalidValueError("edge_wander", self.edge_wander, "0 for a mask that is an image")

    @classmethod
    def from_png(
        cls, path: Path | str, *, stripes: int, fov_rad: float = math.radians(60.0), edge_roughness: float = 0.0
    ) -> "StripeMask":
        """Read a mask drawn as a grey PNG that spans the field: grey is transmission.

        Vertical stripes, of any widths and greys, become a `profile`; any other picture becomes a `pattern`. A picture other
        than vertical stripes must be square, as the field is; one with more than 1024 rows or columns is shrunk to 1024.

        Args:
            path: The file, grey and opaque.
            stripes: Periods across the field.
            fov_rad: Full field of view that the mask fills.
            edge_roughness: See the attribute.

        Raises:
            MissingFileError: If there is no such file.
            InvalidValueError: If it is not a readable PNG, not grey or not opaque, transmits hardly any light, or is neither
                vertical stripes nor square.
        """
        transmission = _read_grey(check_file("mask image", path, "give a PNG"))
        if transmission.max() < _BRIGHT_ENOUGH:
            raise InvalidValueError(
                "brightest transmission of the mask image", round(float(transmission.max()), 4), f"{_BRIGHT_ENOUGH:g} to 1"
            )
        if np.ptp(transmission, axis=0).max() <= _SAME_ROW:
            steps = tuple(float(value) for value in transmission.mean(axis=0))
            return cls(stripes=stripes, profile=steps, fov_rad=fov_rad, edge_roughness=edge_roughness)
        height, width = transmission.shape
        if max(height, width) > _SQUARE * min(height, width):
            allowed = "square within 5 %, as the field is, unless all its rows are alike (within 2 %)"
            raise InvalidValueError("size of mask image", f"{width} x {height}", allowed)
        pattern = encode_pattern(_averaged(transmission))
        return cls(stripes=stripes, pattern=pattern, fov_rad=fov_rad, edge_roughness=edge_roughness)

    @property
    def is_drawn(self) -> bool:
        """Whether `profile` or `pattern` defines the mask, not `stripes`, `duty` and `phase`."""
        return self.profile is not None or self.pattern is not None

    @property
    def varies_along_y(self) -> bool:
        """Whether the transmission depends on y as well as on x."""
        return self.pattern is not None or self.edge_wander > 0.0

    @property
    def half_width_tan(self) -> float:
        """Half the width of the mask in tangent units; it lights nothing beyond."""
        return math.tan(self.fov_rad / 2.0)

    @property
    def period_tan(self) -> float:
        """Period of the stripes in tangent units."""
        return 2.0 * self.half_width_tan / self.stripes


def _averaged(transmission: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shrink an image (H, W) to the size that a pattern may have, by the mean over the area of each new pixel."""
    from PIL import Image  # comes with matplotlib; only needed here

    height, width = (min(size, LARGEST_SIDE) for size in transmission.shape)
    if (height, width) == transmission.shape:
        return transmission
    shrunk = Image.fromarray(transmission.astype(np.float32)).resize((width, height), Image.Resampling.BOX)
    return np.clip(np.asarray(shrunk, dtype=np.float64), 0.0, 1.0)


def _read_grey(path: Path) -> NDArray[np.float64]:
    """Return a PNG's grey values, (H, W) from 0 to 1."""
    from PIL import Image, UnidentifiedImageError  # comes with matplotlib; only needed here

    try:
        with Image.open(path, formats=["PNG"]) as image:
            width, height, mode = image.width, image.height, image.mode
            if not (16 <= width <= 16384 and 1 <= height <= 16384):
                raise InvalidValueError("size of mask image", f"{width} x {height}", "16 to 16384 columns, 1 to 16384 rows")
            if mode not in {"1", "L", "I;16", "I", "P", "RGB", "RGBA", "LA"}:
                raise InvalidValueError("mode of mask image", mode, "grey, 8 or 16 bits")
            values = np.asarray(image.convert("RGBA") if mode in {"P", "RGB", "RGBA", "LA"} else image, dtype=np.float64)
    except (UnidentifiedImageError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise InvalidValueError("mask image", str(path), f"a PNG that can be read ({error})") from error
    if values.ndim == 3:
        if values[..., 3].min() < 255.0:
            raise InvalidValueError("mask image", str(path), "an opaque image; it has transparent pixels")
        if np.ptp(values[..., :3], axis=-1).max() > 0.0:
            raise InvalidValueError("mask image", str(path), "a grey image; it has colours")
        values = values[..., 0]
    full_scale = {"1": 1.0, "I": 65535.0, "I;16": 65535.0}.get(mode, 255.0)
    return values / full_scale
