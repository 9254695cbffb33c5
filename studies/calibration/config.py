"""Which pictures a bench is calibrated from."""

from dataclasses import field
from typing import Annotated

from laploop.assets.calibration_board import CalibrationBoard
from laploop.assets.ranges import Span, check_ordered
from laploop.configuration import Field, Seed, configuration
from laploop.studies.scenes.optical_bench import OpticalBench

Views = Annotated[int, Field(ge=5, le=1000)]
Depth = Annotated[float, Field(ge=0.03, le=0.3)]


@configuration
class CalibrationConfig:
    """Which pictures are taken.

    The reference camera's own pictures, of a large board, replace its maker's calibration; the card lies under the stripes in
    the poses of the pairs.
    """

    views: Views = 20
    """Pictures in each step: the scope's own, the reference camera's own, pairs, stripes on a card, poses of the arm."""
    seed: Seed = 0
    """Of the poses and the sensors' noise."""
    bench: OpticalBench = field(default_factory=OpticalBench)
    board: CalibrationBoard = field(
        default_factory=lambda: CalibrationBoard(columns=10, rows=9, square_mm=5.0, border_mm=5.0, edge_mm=0.7)
    )
    """Of the scope and the pairs; it has 72 corners, one with squares of 7 mm 42."""
    factory_board: CalibrationBoard = field(
        default_factory=lambda: CalibrationBoard(columns=11, rows=10, square_mm=22.0, border_mm=22.0, edge_mm=0.8)
    )
    """Of the reference camera's own pictures; fills its field."""
    own_depths_m: Span[Depth] = (0.065, 0.11)
    """Nearest and farthest of the board in the scope's own pictures."""
    pair_depths_m: Span[Depth] = (0.07, 0.13)
    """The same, from the scope, in the pairs."""
    projector: bool = True
    """Calibrate the stripe projector as well."""
    hand_eye: bool = True
    """Calibrate the scope on the arm's flange as well."""
    joint_noise_rad: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """Standard deviation of the joint angles that the arm reports."""

    def __post_init__(self) -> None:
        check_ordered(self)

    @property
    def pictures(self) -> int:
        """Number of views taken in all; the progress counts up to it."""
        return self.views * (3 + self.projector + self.hand_eye)
