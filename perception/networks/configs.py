"""Sizes of the depth networks: what decides whether weights fit. Every weights file has one of these in its header."""

from dataclasses import replace
from typing import Annotated, ClassVar, Self

from laploop.configuration import Field, configuration, to_plain
from laploop.errors import InvalidValueError

Channels = Annotated[int, Field(ge=4, le=2048)]
Factors = tuple[Annotated[int, Field(ge=1, le=64)], ...]
Pixels = Annotated[int, Field(ge=16, le=4096)]
FarthestMm = Annotated[float, Field(gt=0.0, le=10_000.0)]
Windows = tuple[tuple[Annotated[float, Field(gt=0.0, le=10.0)], Annotated[float, Field(gt=0.0, le=100.0)]], ...]
_LEVELS = 8
"""Most levels of a U-Net or an encoder: the image is halved at each."""


def _check_levels(name: str, values: tuple[object, ...], *, least: int = 2) -> None:
    if not least <= len(values) <= _LEVELS:
        raise InvalidValueError(name, values, f"{least} to {_LEVELS} values")


@configuration
class NetworkConfig:
    """What the configurations of all networks have in common."""

    form: ClassVar[str]
    """Changes whenever the same weights would mean something else."""

    @property
    def architecture(self) -> dict[str, object]:
        """What decides whether weights fit, as plain data."""
        return {"format": self.form, **to_plain(self)}

    def for_image(self, height: int, width: int) -> Self:  # noqa: ARG002 - for networks that are made for one size
        """Return the configuration for images of another size; the same where any size will do."""
        return self

    def check_image(self, whose: str, size: tuple[int, int]) -> None:
        """Raise an `InvalidValueError` that says whose images (height, width) have another size than the network's."""


@configuration
class SizedNetworkConfig(NetworkConfig):
    """A configuration of a network that takes images of one size."""

    height: Pixels = 256
    width: Pixels = 256

    def for_image(self, height: int, width: int) -> Self:
        """Return the same network for images of another size."""
        return replace(self, height=height, width=width)

    def check_image(self, whose: str, size: tuple[int, int]) -> None:
        """Refuse images (height, width) of another size than the network's."""
        if size != (self.height, self.width):
            allowed = f"{(self.height, self.width)}, for which the network was made"
            raise InvalidValueError(f"image (height, width) of {whose}", size, allowed)

    def check_multiple(self, step: int) -> None:
        """Raise an `InvalidValueError` unless height and width are multiples of `step`, to be halved often enough."""
        if self.height % step or self.width % step:
            raise InvalidValueError("image (height, width)", (self.height, self.width), f"multiples of {step}")


@configuration
class CompactConfig(SizedNetworkConfig):
    """Sizes of `compact`."""

    form: ClassVar[str] = "laploop-compact-3"
    windows: Windows = ((0.6, 2.0), (0.35, 1.0))
    """Demodulation windows: standard deviation along x in periods and along y in pixels. The first gives the phase."""
    widths: tuple[Channels, ...] = (16, 48, 96, 128, 160)
    """Channels of each level, from half the image's size down by powers of two. The first costs most of the time."""

    def __post_init__(self) -> None:
        _check_levels("widths", self.widths)
        _check_levels("windows", self.windows, least=1)
        self.check_multiple(2 ** len(self.widths))


@configuration
class SslePhaseConfig(NetworkConfig):
    """Sizes of `ssle-phase`."""

    form: ClassVar[str] = "laploop-ssle-phase-3"
    reader: CompactConfig = CompactConfig()
    """The first part."""
    refiner_widths: tuple[Channels, ...] = (48, 64, 96, 128, 160)
    """Channels of each level of the refiner, from half the image's size down by powers of two."""

    def __post_init__(self) -> None:
        _check_levels("refiner_widths", self.refiner_widths)
        # The refiner smooths over squares of 16 pixels.
        self.reader.check_multiple(max(2 ** len(self.refiner_widths), 16))

    def for_image(self, height: int, width: int) -> Self:
        """Return the same network for images of another size."""
        return replace(self, reader=self.reader.for_image(height, width))

    def check_image(self, whose: str, size: tuple[int, int]) -> None:
        """Refuse images (height, width) of another size than the network's."""
        self.reader.check_image(whose, size)


@configuration
class LatentUNetConfig:
    """Sizes of a bilinear U-Net."""

    base: Channels = 128
    """Channels of the finest level."""
    multipliers: Factors = (1, 2, 4, 8, 8)
    """Width of each level in units of the base, the bottleneck last; the paper's are 128, 256, 512, 1024 and 1024."""

    def __post_init__(self) -> None:
        _check_levels("multipliers", self.multipliers)

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each encoder level, finest first, the bottleneck last."""
        return tuple(self.base * factor for factor in self.multipliers)

    @property
    def shrink(self) -> int:
        """Sides of the input must be multiples of this."""
        return int(2 ** (len(self.multipliers) - 1))


@configuration
class VqVaeConfig:
    """Sizes of the VQ-VAE of one domain, stripe images or depth maps."""

    fold: Annotated[int, Field(ge=1, le=16)] = 1
    """Squares of this many pixels a side become channels before the first layer, and pixels again after the last; 1 leaves the
    image as it is. Not in the paper: it saves the layers at full size, where a CPU spends most of its time."""
    base: Channels = 64
    """Channels of the first level."""
    multipliers: Factors = (1, 2)
    """Width of each level in units of the base; every level but the first has half the size of the one before."""
    blocks: Annotated[int, Field(ge=1, le=16)] = 2
    """Residual blocks a level."""
    attention: bool = True
    """Self-attention at the coarsest level."""
    latent: Annotated[int, Field(ge=1, le=1024)] = 64
    """Numbers in a latent vector and in a codebook entry."""
    entries: Annotated[int, Field(ge=2, le=65_536)] = 512
    """Entries of the codebook."""
    restart_after: Annotated[int, Field(ge=0, le=1_000_000)] = 64
    """Training batches without use after which an entry is moved; 0 for never."""

    def __post_init__(self) -> None:
        _check_levels("multipliers", self.multipliers, least=1)

    @property
    def shrink(self) -> int:
        """Image pixels along one side of a latent pixel."""
        return int(self.fold * 2 ** (len(self.multipliers) - 1))

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels of each level."""
        return tuple(self.base * factor for factor in self.multipliers)


@configuration
class SsleConfig(SizedNetworkConfig):
    """Sizes of `ssle`; the defaults are the paper's."""

    form: ClassVar[str] = "laploop-ssle-1"
    image: VqVaeConfig = VqVaeConfig()
    depth: VqVaeConfig = VqVaeConfig(entries=1024)
    unet: LatentUNetConfig = LatentUNetConfig()
    farthest_mm: FarthestMm = 250.0
    """The tanh's range ends there; it starts at 0."""
    quantize_depth: bool = False
    """Replace the predicted latent by codebook entries before the decoder."""

    def __post_init__(self) -> None:
        if self.image.shrink != self.depth.shrink:
            shrinks = (self.image.shrink, self.depth.shrink)
            raise InvalidValueError("image pixels a latent pixel, of image and depth", shrinks, "the same for both")
        self.check_multiple(self.image.shrink * self.unet.shrink)


@configuration
class DualUNetConfig(SizedNetworkConfig):
    """Sizes of the two networks of `dual-unet`; the defaults are those of a usual U-Net, 31 M parameters in all."""

    form: ClassVar[str] = "laploop-dual-unet-1"
    mask: LatentUNetConfig = LatentUNetConfig(base=64)
    depth: LatentUNetConfig = LatentUNetConfig(base=64)
    farthest_mm: FarthestMm = 250.0
    """The depth network's sigmoid ends there; it starts at 0."""

    def __post_init__(self) -> None:
        self.check_multiple(max(self.mask.shrink, self.depth.shrink))
