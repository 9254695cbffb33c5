"""Which training frames are rendered."""

from dataclasses import field
from typing import Annotated, Any

import numpy as np

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_appearance import AppearanceRanges, TissueAppearance, draw_appearance
from laploop.configuration import Field, Seed, Workers, configuration, to_plain
from laploop.envs.sensors.optics.scope_ranges import ScopeRanges, draw_scope
from laploop.errors import InvalidValueError
from laploop.studies.scenes.frame_conditions import FrameRanges

_STREAM = 71
"""Keeps the random numbers apart from those of theatres, whose seeds are small integers too."""

Tissues = Annotated[int, Field(ge=0, le=100_000)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


@configuration
class TrainingFramesConfig:
    """How many frames of how many tissues; no tissue is in two splits."""

    train_tissues: Tissues = 150
    val_tissues: Tissues = 10
    test_tissues: Tissues = 20
    frames_per_tissue: Annotated[int, Field(ge=1, le=10_000)] = 18
    tool_share: Fraction = 0.5
    """Fraction of the frames with the instrument in view."""
    seed: Seed = 0
    workers: Workers = 2
    """Processes that render; the frames do not depend on their number."""
    optics: ScopeOptics = field(default_factory=ScopeOptics)
    ranges: FrameRanges = field(default_factory=FrameRanges)
    randomised_scopes: Fraction = 0.0
    """Fraction of the tissues seen through a scope of their own, drawn from `scope_ranges`."""
    scope_ranges: ScopeRanges = field(default_factory=ScopeRanges)
    randomised_appearances: Fraction = 0.0
    """Fraction of the tissues with patches and detail drawn from `appearance_ranges`."""
    appearance_ranges: AppearanceRanges = field(default_factory=AppearanceRanges)
    large_tool_share: Fraction = 0.0
    """Fraction of the frames with the instrument in which it covers a large part of the view."""
    ill_exposed_share: Fraction = 0.0
    """Fraction of the frames in which a tenth to half of the pixels are saturated, or dark."""

    def __post_init__(self) -> None:
        if self.tissues == 0:
            raise InvalidValueError("number of tissues", 0, "at least 1 over the three splits")
        if self.frames > 1_000_000:
            raise InvalidValueError("number of frames", self.frames, "at most 1000000")

    @property
    def tissues(self) -> int:
        """Number of tissues in all."""
        return self.train_tissues + self.val_tissues + self.test_tissues

    @property
    def frames(self) -> int:
        """Number of frames in all."""
        return self.tissues * self.frames_per_tissue

    @property
    def recipe(self) -> dict[str, Any]:
        """What decides the frames' content, as JSON has it."""
        return {name: value for name, value in to_plain(self).items() if name not in {"workers", "optics"}}

    def tissue_rng(self, tissue: int) -> np.random.Generator:
        """Return the generator of a tissue's shape and texture, at its start."""
        return np.random.default_rng([self.seed, _STREAM, 0, tissue])

    def frame_rng(self, index: int) -> np.random.Generator:
        """Return the generator of a frame, at its start; its first number decides about the instrument."""
        return np.random.default_rng([self.seed, _STREAM, 1, index])

    def scope_of(self, tissue: int) -> ScopeOptics:
        """Return the scope through which a tissue is seen."""
        rng = np.random.default_rng([self.seed, _STREAM, 2, tissue])
        drawn = self.randomised_scopes > 0.0 and rng.random() < self.randomised_scopes
        return draw_scope(self.optics, rng, self.scope_ranges) if drawn else self.optics

    def appearance_of(self, tissue: int) -> TissueAppearance:
        """Return what a tissue looks like."""
        rng = np.random.default_rng([self.seed, _STREAM, 3, tissue])
        drawn = rng.random() < self.randomised_appearances
        return draw_appearance(rng, self.appearance_ranges) if drawn else TissueAppearance()
