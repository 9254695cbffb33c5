"""Depth maps and their errors as pictures: colours, and the key to them."""

import io
from functools import cache

import numpy as np
from numpy.typing import NDArray

Pictures = NDArray[np.uint8]

ERROR_RANGE_MM = 3.0
"""The colours of depth errors span this in both directions."""

_DEPTH_SHADES = 255
_ERROR_SHADES = 61
"""One a tenth of a millimetre: more would only keep noise."""
_GREY = (128, 128, 128)
"""In neither map: where the error is zero, its colour is nearly white."""

_MARGIN_MM = 12.0
"""The amplitude of breathing, about, by which the first frame's depths are widened."""


@cache
def palette(name: str, shades: int) -> Pictures:
    """Return the colours of a matplotlib map and, last, the grey of unknown pixels as RGB, (shades + 1, 3)."""
    from matplotlib import colormaps

    colors = colormaps[name](np.linspace(0.0, 1.0, shades))[:, :3]
    return np.vstack([np.round(colors * 255), _GREY]).astype(np.uint8)


class ColorScale:
    """A range of values in millimetres and its colours; what lies outside has the colour of the nearer end."""

    def __init__(self, low_mm: float, high_mm: float, map_name: str, shades: int) -> None:
        self.low_mm = low_mm
        self.high_mm = high_mm
        self.palette = palette(map_name, shades)

    @classmethod
    def of_errors(cls) -> "ColorScale":
        """Return the scale of errors: red is too near, white is right, blue is too far."""
        return cls(-ERROR_RANGE_MM, ERROR_RANGE_MM, "RdBu", _ERROR_SHADES)

    @classmethod
    def of_depths(cls, exact_depth_mm: NDArray[np.float32]) -> "ColorScale":
        """Return the scale of depths, near dark, far bright: those of a first frame, widened for the tissue's motion."""
        if not np.isfinite(exact_depth_mm).any():
            return cls(50.0, 150.0, "viridis", _DEPTH_SHADES)
        near, far = np.nanpercentile(exact_depth_mm, [1.0, 99.0])
        return cls(max(float(near) - _MARGIN_MM, 0.0), float(far) + _MARGIN_MM, "viridis", _DEPTH_SHADES)

    def indices(self, values_mm: NDArray[np.floating]) -> Pictures:
        """Return the rows of the palette for values, of any shape; the last one where a value is not finite."""
        unknown = len(self.palette) - 1
        shade = (values_mm - self.low_mm) * ((unknown - 1) / (self.high_mm - self.low_mm))
        known = np.isfinite(shade)
        return np.where(known, np.rint(np.clip(np.where(known, shade, 0.0), 0.0, unknown - 1)), unknown).astype(np.uint8)

    def colors(self, values_mm: NDArray[np.floating]) -> Pictures:
        """Return the colours of values, (...), as RGB, (..., 3)."""
        return self.palette[self.indices(values_mm)]

    def png(self, values_mm: NDArray[np.floating]) -> bytes:
        """Return a map, (height, width), as a PNG with this palette: a third of the bytes that three channels take."""
        from PIL import Image

        picture = Image.fromarray(self.indices(values_mm))
        picture.putpalette(self.palette.tobytes())
        stream = io.BytesIO()
        picture.save(stream, format="PNG", compress_level=6)
        return stream.getvalue()


def key_picture(scale: ColorScale, title: str, *, width: int = 480, height: int = 64) -> Pictures:
    """Return a colour bar with its title and the values at its ends and in its middle, as RGB, (height, width, 3)."""
    import cv2

    margin, top = 24, 26
    picture = np.full((height, width, 3), 255, dtype=np.uint8)
    picture[top : height - 22, margin : width - margin] = scale.colors(
        np.linspace(scale.low_mm, scale.high_mm, width - 2 * margin)
    )

    def write(text: str, middle: float, baseline: int) -> None:
        font, size = cv2.FONT_HERSHEY_SIMPLEX, 0.42
        (length, _), _ = cv2.getTextSize(text, font, size, 1)
        left = int(np.clip(middle - 0.5 * length, 2, width - length - 2))
        cv2.putText(picture, text, (left, baseline), font, size, (30, 30, 30), 1, cv2.LINE_AA)

    write(title, 0.5 * width, 17)
    for fraction in (0.0, 0.5, 1.0):
        value = scale.low_mm + fraction * (scale.high_mm - scale.low_mm)
        write(
            f"{value:+.0f}" if value and scale.low_mm < 0.0 else f"{value:.0f}",
            margin + fraction * (width - 2 * margin),
            height - 7,
        )
    return picture
