"""Whether a picture shows the rig's stripes at all, so that a network is not believed on a picture without any.

The stripes are looked for as the classical estimator reads them, in a longer window, which also finds them in a picture of few
grey values: a contrast above noise, and a wave that fits. Any texture has such spots; stripes differ from them by their
frequency. In units of turns a period, the phase left after the carrier is taken out drifts by

    b tan(slope) / Z

from one period to the next, b being the baseline: 0.06 on a surface tilted by 45 degrees at 80 mm. Stripes of a pitch that is
20 % off drift by 0.2 everywhere; in textures and rings the drift is another from spot to spot.

Of stripes whose pitch is farther off, the window leaves little but noise, which may drift by anything. They are known by this,
that readers of other pitches see more of them than the rig's own.

A pitch that is 5 % off looks like a tilted surface. Phase and baseline of the calibration, and whether the picture is mirrored,
change neither pitch nor direction of the stripes: nothing of that is seen here.
"""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from laploop.configuration import Field, configuration
from laploop.perception.carrier import StripeCarrier
from laploop.perception.estimators.base import check_image
from laploop.perception.estimators.phase import PhaseConfig, PhaseEstimator
from laploop.perception.geometry import Rig

_Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
_Drift = Annotated[float, Field(gt=0.0, le=0.5)]

_RIVALS = (1.0 / 2.5, 1.0 / 1.7, 1.0 / 1.2, 1.2, 1.7)
"""Pitches, relative to the rig's own, that are tried against it. A reader sees a good part of stripes within 20 % of its own,
and next to nothing of wider ones."""


@configuration
class StripeCheckConfig:
    """What counts as stripes.

    The thresholds lie between pictures without them (textures, text, stripes of other widths) and rendered tissue, be it dark,
    saturated, or hidden by an instrument; what each side reaches is said at the fields.
    """

    window_periods: Annotated[float, Field(gt=0.0, le=10.0)] = 1.0
    """Standard deviation of the Gaussian window along the stripes' x, in periods."""
    support_px: Annotated[float, Field(gt=0.0, le=100.0)] = 6.0
    """Standard deviation of the averaging across rows."""
    min_amplitude: Annotated[float, Field(ge=0.0, le=255.0)] = 0.3
    """Least amplitude of the stripes, in grey values."""
    min_contrast: _Fraction = 0.1
    """Least amplitude relative to the local mean."""
    max_residual: Annotated[float, Field(gt=0.0, le=100.0)] = 1.2
    """Largest misfit of the fitted wave, root mean square relative to its amplitude."""
    max_step_turns: _Drift = 0.15
    """Largest drift at a pixel that counts as striped, turns a period."""
    min_fraction: _Fraction = 0.04
    """Least fraction of the image that is striped: tissue 0.08 or more, textures 0.03 or less."""
    max_drift_turns: _Drift = 0.1
    """Largest mean drift along y, turns a period: tissue 0.07."""
    max_pitch_turns: _Drift = 0.06
    """Largest mean drift along x: tissue 0.05, stripes 10 % too wide or too narrow 0.09."""
    max_spread_turns: _Drift = 0.06
    """Largest mean deviation of the drift from its median: tissue 0.04, a texture that has only waves of the stripes' length
    0.08."""
    max_rival: Annotated[float, Field(gt=0.0, le=100.0)] = 1.25
    """Largest fraction that is striped for a reader of another pitch, relative to that of the rig's own: tissue 1.0, stripes
    30 % too wide or too narrow mostly 4 or more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StripePresence:
    """Where a picture shows stripes."""

    striped: NDArray[np.bool_]
    """(height, width), pixels around which the stripes' wave fits and has their frequency."""
    drift_turns: float
    """The larger of the mean drifts of phase along x and y, turns a period; NaN where no wave fits anywhere."""
    spread_turns: float
    """The larger of the mean deviations from the median drift; NaN likewise."""
    present: bool
    """Whether the picture as a whole shows the rig's stripes."""

    @property
    def fraction(self) -> float:
        """Of the image that is striped."""
        return float(self.striped.mean())


class StripeCheck:
    """Looks for a rig's stripes in pictures."""

    def __init__(self, rig: Rig, config: StripeCheckConfig | None = None) -> None:
        """Prepare for a rig, whose camera's images the pictures are."""
        self._rig = rig
        self._config = config or StripeCheckConfig()
        self._reader = _PitchReader(rig, self._config)
        # A camera of another focal length would see the rig's stripes at another pitch.
        cameras = [replace(rig.camera, fx=ratio * rig.camera.fx) for ratio in _RIVALS]
        self._rivals = [_PitchReader(replace(rig, camera=camera), self._config) for camera in cameras]

    def find(self, image: NDArray[np.uint8]) -> StripePresence:
        """Look for the stripes in a picture (height, width).

        Raises:
            InvalidValueError: If the picture is not what the rig's camera delivers.
        """
        check_image(image, self._rig)
        config = self._config
        fits, drift, striped = self._reader.read(image)
        if not fits.any():
            return StripePresence(striped=fits, drift_turns=np.nan, spread_turns=np.nan, present=False)
        found = drift[:, fits]
        along_x, along_y = np.abs(found.mean(axis=1)).tolist()
        spread = float(np.abs(found - np.median(found, axis=1, keepdims=True)).mean(axis=1).max())
        fraction = float(striped.mean())
        present = (
            fraction >= config.min_fraction
            and along_x <= config.max_pitch_turns
            and along_y <= config.max_drift_turns
            and spread <= config.max_spread_turns
            and all(reader.read(image)[2].mean() <= config.max_rival * fraction for reader in self._rivals)
        )
        return StripePresence(striped=striped, drift_turns=max(along_x, along_y), spread_turns=spread, present=present)


class _PitchReader:
    """Reads stripes of one pitch."""

    def __init__(self, rig: Rig, config: StripeCheckConfig) -> None:
        reading = PhaseConfig(window_periods=config.window_periods, support_px=config.support_px)
        self._config = config
        self._saturated = reading.saturated
        self._estimator = PhaseEstimator(rig, reading)
        self._period_px = StripeCarrier(rig=rig).period_px

    def read(self, image: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.bool_]]:
        """Return where a wave fits, its drift along x and y in turns a period (2, height, width), and where it is striped."""
        config = self._config
        seen = self._estimator.demodulate(image)
        fits = (
            (seen.amplitude >= config.min_amplitude)
            & (seen.contrast >= config.min_contrast)
            & (seen.residual <= config.max_residual)
            & (image < self._saturated)
        )
        drift = np.float32(self._period_px) * np.stack([_wrapped_step(seen.fraction, axis) for axis in (1, 0)])
        return fits, drift, fits & (np.abs(drift) <= config.max_step_turns).all(axis=0)


def _wrapped_step(fraction: NDArray[np.float32], axis: int) -> NDArray[np.float32]:
    """Return the step of phase to the next pixel along an axis, in turns from -0.5 to 0.5, same shape."""
    step = np.diff(fraction, axis=axis, append=np.take(fraction, [-1], axis=axis))
    return np.asarray(step - np.round(step), dtype=np.float32)
