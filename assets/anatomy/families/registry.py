"""The families of anatomy by name, and which of them no network may learn from."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType

import numpy as np

from laploop.assets.anatomy.anatomy_mesh import AnatomyMesh
from laploop.errors import UnknownNameError

TISSUE_FAMILY = "tissue"
"""The height fields of `tissue_shape`, which MuJoCo carries: a family like the others in data sets, without a builder here."""


@dataclass(frozen=True, kw_only=True)
class Family:
    """One kind of shape."""

    builder: str
    """`module:function` in this package; the function takes a generator and returns an `AnatomyMesh`."""
    held_out: bool = False
    """Kept for evaluation: no network learns from it, and no weights are chosen by it."""
    weight: float = 1.0
    """How often it is drawn among those of its kind, relative to the others."""
    wall_fraction: float = 0.0
    """Fraction of its scenes with a wall behind it."""
    wall_below: bool = False
    """Whether the wall lies below the lowest point; else it may cut the organ, which then stands out of it."""

    def build(self, rng: np.random.Generator) -> AnatomyMesh:
        """Draw one shape, 80 to 140 mm wide, in about half a second.

        Raises:
            InvalidValueError: If scikit-image (extra `mesh`) is not installed.
        """
        module, _, function = self.builder.partition(":")
        build: Callable[[np.random.Generator], AnatomyMesh] = getattr(import_module(f"{__package__}.{module}"), function)
        return build(rng)


FAMILIES: Mapping[str, Family] = MappingProxyType(
    {
        "bowel-loops": Family(builder="bowel:bowel_loops", weight=1.5, wall_fraction=0.9),
        "lobes": Family(builder="lobes:smooth_lobes", weight=1.5, wall_fraction=0.85),
        "sacs": Family(builder="sacs:sacs", wall_fraction=0.85),
        "folds": Family(builder="folds:overhanging_folds", wall_fraction=0.85),
        "strands": Family(builder="strands:strands", wall_fraction=1.0),
        "cavities": Family(builder="cavities:cavities", wall_fraction=0.8, wall_below=True),
        "resections": Family(builder="resections:resections", wall_fraction=0.85),
        "wall": Family(builder="walls:wall", weight=1.5, wall_fraction=0.5),
        "colon": Family(builder="colon:colon", held_out=True, wall_fraction=0.9),
        "omentum": Family(builder="omentum:omentum", held_out=True, wall_fraction=0.9),
        "mesentery": Family(builder="mesentery:mesentery", held_out=True, wall_fraction=0.9),
        "stomach": Family(builder="stomach:stomach", held_out=True, wall_fraction=1.0),
        "foreign-bodies": Family(builder="foreign_bodies:foreign_bodies", held_out=True, wall_fraction=0.7),
    }
)


def family_named(name: str) -> Family:
    """Return a family.

    Raises:
        UnknownNameError: If there is none of that name.
    """
    if name not in FAMILIES:
        raise UnknownNameError("family of anatomy", name, FAMILIES)
    return FAMILIES[name]


def family_names(*, held_out: bool) -> tuple[str, ...]:
    """Return the names of the families that are held out, or of those that networks may learn from."""
    return tuple(name for name, family in FAMILIES.items() if family.held_out == held_out)
