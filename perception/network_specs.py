"""The depth networks, one entry each, from which the command line, the estimators and the results come."""

from collections.abc import Mapping
from dataclasses import dataclass, field
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
from laploop.perception.training.options import CompactOptions, DualUNetOptions, SsleOptions, SslePhaseOptions, TrainingOptions
from laploop.perception.training.settings import (
    DualUNetTraining,
    PhaseTraining,
    Schedule,
    SsleLoss,
    SslePhaseTraining,
    SsleTraining,
)
from laploop.registry import Registry


@dataclass(frozen=True, kw_only=True)
class NetworkSpec:
    """A depth network; heavy parts are named by `module:attribute` and imported when they are needed."""

    name: str
    """Of the network, of its estimator, and of its weights file."""
    sizes: Mapping[str, NetworkConfig]
    """Configurations by name, the usual one first."""
    network: str
    """A `DepthNetwork`."""
    estimator: str
    """A `NetworkEstimator`."""
    outputs: tuple[str, ...] = ("depth_mm",)
    """Its outputs in other runtimes."""
    trainings: Mapping[str, Any] = field(default_factory=dict)
    """Schedules and weights of the losses by size."""
    options: type[TrainingOptions] | None = None
    """Command-line options of its training; None if it cannot be trained here."""
    train: str = ""
    """A function that is called with a `TrainingRun` and with what the options choose, and returns the path of the weights."""

    @property
    def config(self) -> type[NetworkConfig]:
        """Class of its configurations."""
        return type(next(iter(self.sizes.values())))

    @property
    def weights(self) -> Path:
        """The weights that come with laploop; their card lies beside them, and ends in `.md`."""
        return Path(str(files("laploop.assets") / "weights" / f"{self.name}.safetensors"))

    def sized(self, size: str | None = None) -> NetworkConfig:
        """Return the configuration of a size, by default the usual one; an `UnknownNameError` names those there are."""
        size = next(iter(self.sizes)) if size is None else size
        if size not in self.sizes:
            raise UnknownNameError(f"size of {self.name}", size, self.sizes)
        return self.sizes[size]

    def settings(self, options: TrainingOptions, *, height: int, width: int) -> dict[str, Any]:
        """Return the arguments of a training by name, for images of a size: `config`, `training`, and what it alone takes."""
        chosen = options.chosen(self.sizes, self.trainings)
        return {**chosen, "config": chosen["config"].for_image(height, width)}

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
        estimator="laploop.perception.estimators.network:PhaseNetworkEstimator",
        outputs=("depth_mm", "confidence", "slip"),
        trainings={"small": PhaseTraining(), "tiny": PhaseTraining()},
        options=CompactOptions,
        train="laploop.perception.training.compact:train_compact",
    ),
    NetworkSpec(
        name="ssle-phase",
        sizes={
            "small": SslePhaseConfig(),
            "tiny": SslePhaseConfig(reader=CompactConfig(widths=(8, 8)), refiner_widths=(8, 8)),
        },
        network="laploop.perception.networks.ssle_phase:SslePhase",
        estimator="laploop.perception.estimators.network:PhaseNetworkEstimator",
        outputs=("depth_mm", "confidence", "slip"),
        trainings={"small": SslePhaseTraining(), "tiny": SslePhaseTraining()},
        options=SslePhaseOptions,
        train="laploop.perception.training.ssle_phase:train_ssle_phase",
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
        trainings={
            "small": SsleTraining(
                # In float32: group normalisation casts back and forth, so that bfloat16 makes a step of these slower.
                vq=Schedule(
                    epochs=9, learning_rate=2e-3, final_learning_rate=1e-5, per_step=True, warmup_steps=20, clip_norm=5.0
                ),
                unet=Schedule(
                    epochs=60,
                    learning_rate=2e-3,
                    final_learning_rate=1e-5,
                    per_step=True,
                    warmup_steps=50,
                    clip_norm=5.0,
                    bfloat16=True,
                ),
                # The latent's L1 stays near a half while the depth's falls below a hundredth; at 0.1 it would lead.
                loss=SsleLoss(beta_end=0.02),
                gain_range=0.15,
                tune_decoder=True,
                variants=6,
            ),
            "paper": SsleTraining(),
            "tiny": SsleTraining(
                vq=Schedule(epochs=2, batch=2, learning_rate=2e-3, final_learning_rate=1e-4),
                unet=Schedule(epochs=2, batch=2, learning_rate=2e-3, final_learning_rate=1e-5),
            ),
        },
        options=SsleOptions,
        train="laploop.perception.training.ssle:train_ssle",
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
        trainings={
            "small": DualUNetTraining(
                schedule=Schedule(epochs=22, learning_rate=2e-3, per_step=True, warmup_steps=50, clip_norm=5.0, bfloat16=True),
                gain_range=0.15,
            ),
            "paper": DualUNetTraining(),
            "tiny": DualUNetTraining(schedule=Schedule(epochs=2, batch=2, learning_rate=2e-3)),
        },
        options=DualUNetOptions,
        train="laploop.perception.training.dual_unet:train_dual_unet",
    ),
)

"""The networks that come with laploop, weights included."""

NETWORKS: Registry[NetworkSpec] = Registry("network", "laploop.networks", {spec.name: spec for spec in SHIPPED})
"""The depth networks by name."""
