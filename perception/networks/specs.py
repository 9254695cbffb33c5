"""One entry a depth network: all that the command line, the estimators, the results and the docs need to know of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from typing import Any

from laploop.errors import UnknownNameError
from laploop.perception.networks.configs import (
    CompactConfig,
    DualUNetConfig,
    LatentUNetConfig,
    NetworkConfig,
    SsleConfig,
    SslePhaseConfig,
    VqVaeConfig,
)
from laploop.registry import Registry


@dataclass(frozen=True, kw_only=True)
class NetworkSpec:
    """A depth network; what is heavy is named by `module:attribute` and imported when it is needed."""

    name: str
    """Of the network, of its estimator, and of its weights file."""
    sizes: Mapping[str, NetworkConfig]
    """Configurations by name, the usual one first."""
    network: str
    """A `DepthNetwork`."""
    estimator: str
    """A `NetworkEstimator`."""
    outputs: tuple[str, ...] = ("depth_mm",)
    """What it gives in other runtimes."""

    @property
    def config(self) -> type[NetworkConfig]:
        """Class of its configurations."""
        return type(next(iter(self.sizes.values())))

    @property
    def weights(self) -> Path:
        """The weights that come with laploop; their card lies beside them, and ends in `.md`."""
        return Path(str(files("laploop.assets") / "weights" / f"{self.name}.safetensors"))

    def sized(self, size: str | None = None) -> NetworkConfig:
        """Return the configuration of a size, by default the usual one.

        Raises:
            UnknownNameError: If there is no such size.
        """
        size = next(iter(self.sizes)) if size is None else size
        if size not in self.sizes:
            raise UnknownNameError(f"size of {self.name}", size, self.sizes)
        return self.sizes[size]

    @staticmethod
    def imported(path: str) -> Any:
        """Return what `module:attribute` points at."""
        module, _, attribute = path.partition(":")
        return getattr(import_module(module), attribute)


SHIPPED = (
    NetworkSpec(
        name="compact",
        sizes={"small": CompactConfig(), "tiny": CompactConfig(widths=(8, 8))},
        network="laploop.perception.networks.compact_unet:CompactUNet",
        estimator="laploop.perception.estimators.network:ScaleEstimator",
        outputs=("depth_mm", "log_scale"),
    ),
    NetworkSpec(
        name="ssle-phase",
        sizes={
            "small": SslePhaseConfig(),
            "tiny": SslePhaseConfig(reader_widths=(8, 8), reader_fine_width=8, refiner_widths=(8, 8)),
        },
        network="laploop.perception.networks.ssle_phase:SslePhase",
        estimator="laploop.perception.estimators.network:ScaleEstimator",
        outputs=("depth_mm", "log_scale"),
    ),
    NetworkSpec(
        name="ssle",
        sizes={
            # All at a quarter of the image's size, where a frame costs one CPU core a few hundredths of a second; 16 numbers a
            # latent, since a codebook of 1024 spans no more.
            "small": SsleConfig(
                image=VqVaeConfig(fold=4, base=32, multipliers=(1,), blocks=1, attention=False, latent=16, entries=1024),
                depth=VqVaeConfig(fold=4, base=24, multipliers=(1,), blocks=1, attention=False, latent=16, entries=1024),
                unet=LatentUNetConfig(base=32, multipliers=(1, 2, 4, 4, 4)),
            ),
            "paper": SsleConfig(),
            "tiny": SsleConfig(
                image=VqVaeConfig(base=8, multipliers=(1, 2), blocks=1, attention=False, latent=8, entries=64),
                depth=VqVaeConfig(base=8, multipliers=(1, 2), blocks=1, attention=False, latent=8, entries=64),
                unet=LatentUNetConfig(base=16, multipliers=(1, 2, 2)),
            ),
        },
        network="laploop.perception.networks.ssle_network:SsleNetwork",
        estimator="laploop.perception.estimators.network:RangeEstimator",
    ),
    NetworkSpec(
        name="dual-unet",
        sizes={
            # Below 16 channels at full size a CPU gains next to no time; six levels reach across the whole image.
            "small": DualUNetConfig(
                mask=LatentUNetConfig(base=8, multipliers=(1, 2, 4, 4)),
                depth=LatentUNetConfig(base=16, multipliers=(1, 2, 4, 6, 8, 8)),
            ),
            "paper": DualUNetConfig(),
            "tiny": DualUNetConfig(
                mask=LatentUNetConfig(base=4, multipliers=(1, 2)), depth=LatentUNetConfig(base=8, multipliers=(1, 2, 4))
            ),
        },
        network="laploop.perception.networks.dual_unet:DualUNet",
        estimator="laploop.perception.estimators.network:MaskEstimator",
    ),
)

"""The networks that come with laploop, weights included."""

NETWORKS: Registry[NetworkSpec] = Registry("network", "laploop.networks", {spec.name: spec for spec in SHIPPED})
"""The depth networks by name."""
