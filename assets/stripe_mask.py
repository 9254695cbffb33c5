"""The static binary stripe mask in the projection channel."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.assets.mask_pattern import LARGEST_SIDE, decode_pattern, encode_pattern
from laploop.errors import InvalidValueError, MissingFileError, check_range

_SAME_ROW = 0.02
_SQUARE = 1.05
_BRIGHT_ENOUGH = 0.05


@dataclass(frozen=True, kw_only=True)
class StripeMask:
    """Alternating opaque and transmissive stripes, parallel to the projector's y axis, or any picture.

    A position on the mask is given by the tangent coordinate `x / z` of the ray through it, in the projector's frame: dark
    and bright stripes are equidistant in it. `stripes` counts periods (one dark and one bright stripe each) across the
    field of view; 20 is the optimum that Zuo et al. (J Biomed Opt 30(8):086003, 2025) report for this kind of scope.
    """

    stripes: int = 20
    duty: float = 0.5
    phase: float = 0.0
    """Shift of the pattern along x, as a fraction of a period; a bright stripe starts at the left edge when 0."""
    fov_rad: float = math.radians(60.0)
    edge_roughness: float = 0.0
    """Standard deviation of an edge's wandering along its length, as a fraction of a period: next to nothing for a
    photolithographic chrome mask, more for a printed one. Its mean along the edge is modelled, a soft transition; that is
    what is left of wandering faster than the projector resolves."""
    profile: tuple[float, ...] | None = None
    """Transmission of equally wide steps from the left to the right border instead of stripes, 0 to 1; `from_png` reads it.
    `stripes` should still say how many periods it has, for whoever decodes the image; `duty` and `phase` mean nothing."""
    pattern: str | None = None
    """Transmission over the whole square field instead of stripes, its first row at the smallest y (the top of the camera's
    image), as `mask_pattern` encodes it; `from_png` reads it. What is said of `profile` holds for it too."""
    edge_wander: float = 0.0
    """Standard deviation of the wandering that the projector does resolve, as a fraction of a period: every edge of the
    stripes is displaced along x by a smooth random function of y, Gaussian and on its own."""
    edge_correlation: float = 0.3
    """Length along y over which the wandering persists, as a fraction of a period: the correlation of the displacements at
    two heights is exp(-(difference / length)^2 / 2)."""
    edge_seed: int = 0
    """Tells one specimen of a wandering edge from another."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        if not 1 <= self.stripes <= 200:
            raise InvalidValueError("stripes", self.stripes, "an integer from 1 to 200")
        if not 0.05 <= self.duty <= 0.95:
            raise InvalidValueError("duty", self.duty, "0.05 to 0.95")
        if not 0.0 < self.fov_rad < math.pi:
            raise InvalidValueError("fov_rad", self.fov_rad, "above 0 and below pi")
        if not 0.0 <= self.edge_roughness <= 0.2:
            raise InvalidValueError("edge_roughness", self.edge_roughness, "0 to 0.2 of a period")
        if self.profile is not None:
            # What came from JSON is a list; a mask must stay hashable and equal to what was written.
            object.__setattr__(self, "profile", tuple(float(value) for value in self.profile))
            if not 1 <= len(self.profile) <= 16384:
                raise InvalidValueError("length of profile", len(self.profile), "1 to 16384 steps")
            if not all(0.0 <= value <= 1.0 for value in self.profile):
                raise InvalidValueError("profile", (min(self.profile), max(self.profile)), "transmissions from 0 to 1")
        self._check_second_dimension()

    @classmethod
    def from_png(
        cls, path: Path | str, *, stripes: int, fov_rad: float = math.radians(60.0), edge_roughness: float = 0.0
    ) -> "StripeMask":
        """Read a mask drawn as a grey PNG: grey is transmission, its left and right borders are those of the field.

        Upright stripes, of any widths and greys, become a `profile`; any other picture becomes a `pattern`. As the field is
        square, so must be a picture that is more than upright stripes; one with more than 1024 rows or columns is shrunk to
        as many.

        Args:
            path: The file; colours are refused unless all of them are grey, and so is transparency.
            stripes: How many periods it has.
            fov_rad: Full field of view that it fills.
            edge_roughness: See the attribute.

        Raises:
            MissingFileError: If there is no such file.
            InvalidValueError: If it cannot be read as a PNG, shows something else than grey, lets hardly any light through, or
                is not square and more than upright stripes.
        """
        path = Path(path).expanduser()
        if not path.is_file():
            raise MissingFileError("mask image", path, "give a PNG")
        transmission = _read_grey(path)
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
        """Whether an image says what the mask looks like, and not `stripes`, `duty` and `phase`."""
        return self.profile is not None or self.pattern is not None

    @property
    def varies_along_y(self) -> bool:
        """Whether it takes two coordinates to say where the mask is bright."""
        return self.pattern is not None or self.edge_wander > 0.0

    @property
    def half_width_tan(self) -> float:
        """Half the width of the mask in tangent units; nothing is lit beyond it."""
        return math.tan(self.fov_rad / 2.0)

    @property
    def period_tan(self) -> float:
        """Period of the stripes in tangent units."""
        return 2.0 * self.half_width_tan / self.stripes

    def _check_second_dimension(self) -> None:
        """Check what makes a mask vary along y."""
        check_range("edge_wander", self.edge_wander, 0.0, 0.1)
        check_range("edge_correlation", self.edge_correlation, 0.05, 10.0)
        if not 0 <= self.edge_seed < 2**32:
            raise InvalidValueError("edge_seed", self.edge_seed, "an integer from 0 to 2**32 - 1")
        if self.pattern is not None:
            decode_pattern(self.pattern)
            if self.profile is not None:
                raise InvalidValueError("profile", f"{len(self.profile)} steps beside a pattern", "a profile or a pattern")
        if self.is_drawn and self.edge_wander > 0.0:
            raise InvalidValueError("edge_wander", self.edge_wander, "0 for a mask that is an image")


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
