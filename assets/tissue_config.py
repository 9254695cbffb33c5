"""Shape, mechanics, appearance and resolution of the phantom, as numbers."""

from dataclasses import field
from pathlib import Path
from typing import Annotated

from laploop.assets.tissue_appearance import TissueAppearance
from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

PATTERN_SIZE = 96
"""Samples along one side of the periodic square in which a tissue grows: the most that can be cut from it."""

Length = Annotated[float, Field(ge=0.002, le=0.5)]
Height = Annotated[float, Field(ge=0.001, le=0.1)]
Cells = Annotated[int, Field(ge=2, le=32)]


@configuration
class TissueShape:
    """A family of folded, gut-like tissues; a seed makes one of them."""

    side_m: Annotated[float, Field(ge=0.02, le=0.5)] = 0.120
    """Length and width of the phantom."""
    samples: Annotated[int, Field(ge=9, le=PATTERN_SIZE)] = 61
    """Vertices along one side of the top surface."""
    height_m: Height = 0.029
    """Height of the highest point above the bottom."""
    floor_m: Height = 0.008
    """Least thickness, at the bottom of the deepest crease."""
    lobe_width_min_m: Length = 0.026
    """Least width of a lobe."""
    lobe_width_max_m: Length = 0.034
    """Distance between neighbouring crests: that of an inflated small bowel, 25 to 35 mm across."""
    lobe_height_m: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0125
    """From crease to crest."""
    ridges: Annotated[int, Field(ge=0, le=100)] = 5
    """Bands of tissue that bridge neighbouring lobes."""

    def __post_init__(self) -> None:
        if not self.floor_m < self.height_m:
            raise InvalidValueError("floor_m", self.floor_m, f"below height_m, {self.height_m:g}")
        if not self.lobe_width_min_m <= self.lobe_width_max_m <= self.side_m:
            widths = (self.lobe_width_min_m, self.lobe_width_max_m)
            raise InvalidValueError("lobe_width_min_m and lobe_width_max_m", widths, "smallest <= largest <= side_m")
        if not self.lobe_height_m <= self.height_m - self.floor_m:
            raise InvalidValueError("lobe_height_m", self.lobe_height_m, "0 to height_m - floor_m")

    @property
    def spacing_m(self) -> float:
        """Distance between neighbouring columns of vertices."""
        return self.side_m / (self.samples - 1)


@configuration
class TissueMaterial:
    """Mechanics of the phantom.

    The default stiffness lies in the small-strain range of soft tissue, 2-30 kPa. A coarse lattice cannot dent as locally as
    the continuum, so that a probe feels about 0.3 N/mm at 10 kPa with 10x10 cells.
    """

    young_pa: Annotated[float, Field(ge=100.0, le=1e6)] = 10_000.0
    """Young's modulus."""
    poisson: Annotated[float, Field(ge=0.0, le=0.49)] = 0.45
    """0.45-0.48 keeps a nearly incompressible solid numerically sound."""
    density: Annotated[float, Field(ge=100.0, le=5000.0)] = 1060.0
    """kg/m^3, liver (Phys Med Biol 2019;64:225001)."""
    damping_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """Rayleigh damping in proportion to the stiffness: vibrations die out within a few periods."""
    friction: Annotated[float, Field(ge=0.0, le=2.0)] = 0.05
    """Sliding friction at the upper end of 0.007-0.054, measured for small bowel against steel (Tribol Lett, 2013)."""
    contact_time_s: Annotated[float, Field(ge=0.001, le=0.1)] = 0.004
    """Time constant of a contact; at least twice the physics step."""


@configuration
class TissueConfig:
    """Shape, mechanics, appearance and resolution of the phantom."""

    shape: TissueShape = field(default_factory=TissueShape)
    material: TissueMaterial = field(default_factory=TissueMaterial)
    appearance: TissueAppearance = field(default_factory=TissueAppearance)
    """Patches and detail on top of the smooth texture that each seed has."""
    cells: tuple[Cells, Cells] = (10, 10)
    """Lattice cells along x and y; cost grows with their number, and so does the detail of a dent.

    There is one cell from bottom to top: upper cells above a crease would hold next to no tissue, and their nodes, almost
    without mass and stiffness, would not come to rest.
    """
    contact_every: Annotated[int, Field(ge=1, le=8)] = 1
    """Contacts feel every so many samples of the top along x and y, a divisor of `shape.samples - 1`; the eye sees them all."""
    mesh: Path | None = None
    """A closed surface in millimetres (.stl, .obj or .ply) to be the phantom instead of a tissue that `shape` grows."""

    def __post_init__(self) -> None:
        if (self.shape.samples - 1) % self.contact_every:
            raise InvalidValueError("contact_every", self.contact_every, f"a divisor of {self.shape.samples - 1}")

    @property
    def nodes(self) -> tuple[int, int, int]:
        """Lattice nodes along x, y and z."""
        return self.cells[0] + 1, self.cells[1] + 1, 2
