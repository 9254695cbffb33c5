"""Which training frames are rendered."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from laploop.assets.anatomy.families.registry import FAMILIES, TISSUE_FAMILY, Family, family_named, family_names
from laploop.assets.anatomy.textures import OWN_TEXTURE, TEXTURES, Texture
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.tissue_appearance import AppearanceRanges, TissueAppearance, draw_appearance
from laploop.configuration import Field, Seed, Workers, configuration, to_plain
from laploop.envs.sensors.optics.scope_ranges import ScopeRanges, draw_scope
from laploop.errors import InvalidValueError
from laploop.studies.scenes.anatomy_optics import AnatomyRanges
from laploop.studies.scenes.frame_conditions import FrameRanges

_STREAM = 71
"""Keeps the random numbers apart from those of theatres, whose seeds are small integers too."""

Tissues = Annotated[int, Field(ge=0, le=100_000)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class World:
    """What a scene is."""

    family: str = TISSUE_FAMILY
    texture: str = OWN_TEXTURE


@configuration
class TrainingFramesConfig:
    """How many frames of how many tissues; no tissue is in two splits."""

    train_tissues: Tissues = 150
    """Tissues to learn from."""
    val_tissues: Tissues = 10
    """Tissues to choose the best epoch by."""
    test_tissues: Tissues = 20
    """Tissues to evaluate on."""
    frames_per_tissue: Annotated[int, Field(ge=1, le=10_000)] = 18
    """Frames of each tissue."""
    tool_share: Fraction = 0.5
    """Fraction of the frames with the instrument in view."""
    seed: Seed = 0
    """Decides the tissues, the poses and all noise."""
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
    """Fraction of the frames of tissues with the instrument in which it covers a large part of the view. In anatomy scenes one
    instrument in five is close to the lens."""
    ill_exposed_share: Fraction = 0.0
    """Fraction of the frames in which a tenth to half of the pixels are saturated, or dark."""
    unshaded_share: Fraction = 0.0
    """Fraction of the frames whose shading is divided out, so that a network cannot take depth from brightness. The shipped
    networks learned without such frames."""
    varied_light: Fraction = 0.0
    """Fraction of the frames of tissues whose spread of light and camera response are drawn as those of anatomy are."""
    worlds: Fraction = 0.0
    """Fraction of the scenes that show anatomy of many families, without physics, in place of a tissue."""
    families: tuple[str, ...] = ()
    """Families of anatomy to draw from, evenly; one that is named twice comes twice as often. By default all that networks may
    learn from, or, with `held_out`, all that are held out."""
    held_out: bool = False
    """Render only families of anatomy that no network may learn from, half of them in a held-out texture; test split only."""
    anatomy_ranges: AnatomyRanges = field(default_factory=AnatomyRanges)
    """Pose, light and surfaces of anatomy scenes."""

    def __post_init__(self) -> None:
        if self.tissues == 0:
            raise InvalidValueError("number of tissues", 0, "at least 1 over the three splits")
        if self.frames > 1_000_000:
            raise InvalidValueError("number of frames", self.frames, "at most 1000000")
        for name in self.families:
            if family_named(name).held_out != self.held_out:
                allowed = ", ".join(family_names(held_out=self.held_out))
                raise InvalidValueError("families", name, f"with held_out {self.held_out}: {allowed}")
        if self.families and self.worlds == 0.0 and not self.held_out:
            raise InvalidValueError("families", self.families, "none with worlds 0")
        if self.held_out and self.train_tissues + self.val_tissues > 0:
            splits = (self.train_tissues, self.val_tissues)
            raise InvalidValueError("train_tissues and val_tissues", splits, "0 and 0 with held_out")

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

    def world_of(self, tissue: int) -> World:
        """Return what a scene shows."""
        rng = np.random.default_rng([self.seed, _STREAM, 4, tissue])
        anatomy, unseen_texture = rng.random(), rng.random()
        if not self.held_out and anatomy >= self.worlds:
            return World()
        return World(
            family=self._drawn_family(rng),
            texture=_drawn(_kept(TEXTURES, held_out=self.held_out and unseen_texture < 0.5), rng),
        )

    def _drawn_family(self, rng: np.random.Generator) -> str:
        if self.families:
            return self.families[rng.integers(len(self.families))]
        return _drawn(_kept(FAMILIES, held_out=self.held_out), rng)


def _kept(kinds: Mapping[str, Family] | Mapping[str, Texture], *, held_out: bool) -> dict[str, float]:
    """Return the weights, by name, of those that are held out or of those that are not."""
    return {name: kind.weight for name, kind in kinds.items() if kind.held_out == held_out}


def _drawn(weights: Mapping[str, float], rng: np.random.Generator) -> str:
    values = np.array(list(weights.values()))
    return list(weights)[rng.choice(len(values), p=values / values.sum())]
