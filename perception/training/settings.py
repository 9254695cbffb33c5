"""Schedules, and what the losses weigh, of every network's training; nothing here loads torch."""

import math
from dataclasses import replace
from typing import Annotated, Literal, Self

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

Count = Annotated[int, Field(ge=1, le=1_000_000)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Rate = Annotated[float, Field(gt=0.0, le=10.0)]
Weight = Annotated[float, Field(ge=0.0, le=1e6)]
GainRange = Annotated[float, Field(ge=0.0, lt=1.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Beta = Annotated[float, Field(ge=0.0, lt=1.0)]


@configuration
class Schedule:
    """How long and how fast one stage learns."""

    epochs: Count
    batch: Count = 4
    """Frames a step."""
    accumulate: Count = 1
    """Batches whose gradients are added before a step."""
    learning_rate: Rate = 1e-3
    """At the start of the cosine."""
    final_learning_rate: Annotated[float, Field(ge=0.0, le=10.0)] = 1e-6
    """At the end of the cosine; the same as the start for a constant rate."""
    per_step: bool = False
    """Lower the rate at every step; off, once an epoch, which reaches the final rate in the last epoch, as the paper does
    (161 epochs, T_max 160)."""
    warmup_steps: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Steps of a linear start."""
    optimizer: Literal["adam", "muon"] = "adam"
    """`muon` takes steps of orthogonalised momentum for all kernels but those of `Recipe.adam_layers`."""
    betas: tuple[Beta, Beta] = (0.9, 0.999)
    weight_decay: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Decoupled, as in AdamW; 0 makes it plain Adam."""
    clip_norm: Weight = 0.0
    """Largest norm of the gradient; 0 for no limit."""
    bfloat16: bool = False
    """Convolutions in bfloat16; halves the time of a step where the processor has instructions for it."""
    seed: Seed = 0
    """Decides the first weights, the order and the augmentation."""

    def __post_init__(self) -> None:
        if self.final_learning_rate > self.learning_rate:
            raise InvalidValueError("final_learning_rate", self.final_learning_rate, "0 to learning_rate")

    def rate(self, batch: int, batches: int) -> float:
        """Return the learning rate before a batch, counted from the very first; `batches` is their number in an epoch."""
        epoch, within = divmod(batch, batches)
        done = (epoch + within / batches) / self.epochs if self.per_step else epoch / max(1, self.epochs - 1)
        cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, done)))
        start = min(1.0, (batch // self.accumulate + 1) / (self.warmup_steps + 1))
        return start * (self.final_learning_rate + (self.learning_rate - self.final_learning_rate) * cosine)

    def changed(
        self,
        *,
        seed: int,
        epochs: int | None = None,
        batch: int | None = None,
        accumulate: int | None = None,
        learning_rate: float | None = None,
    ) -> Self:
        """Return the schedule with what is given; the final rate keeps its ratio to the first."""
        ratio = self.final_learning_rate / self.learning_rate
        return replace(
            self,
            seed=seed,
            epochs=epochs or self.epochs,
            batch=batch or self.batch,
            accumulate=accumulate or self.accumulate,
            learning_rate=learning_rate or self.learning_rate,
            final_learning_rate=ratio * learning_rate if learning_rate else self.final_learning_rate,
        )


@configuration
class Machine:
    """Where to train; handed to Lightning as it is."""

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    """What computes; auto takes a GPU where there is one."""
    devices: Annotated[int, Field(ge=1, le=1024)] = 1
    """Processes on each node, one a device."""
    nodes: Annotated[int, Field(ge=1, le=1024)] = 1
    """Machines that train together."""
    strategy: str = "auto"
    """`ddp`, for example; `auto` picks it where there are several processes."""
    workers: Annotated[int, Field(ge=0, le=1024)] = 0
    """Processes that load frames; 0 loads them in the training process, fastest where the augmentation is cheap."""
    tensorboard: bool = True
    """Write TensorBoard's event files as well as the CSV log."""

    @property
    def processes(self) -> int:
        """How many train together."""
        return self.devices * self.nodes


@configuration
class SsleLoss:
    """Weights that the paper names without a value; each default is a choice of ours."""

    alpha: Annotated[float, Field(ge=0.0, le=1.0)] = 0.84
    """Fraction of L1; the rest is SSIM's. Zhao et al. 2017 give SSIM 0.84 for pictures; here the millimetres count."""
    beta_start: Weight = 0.01
    """Weight of the latent L1 at the start of the U-Net's training."""
    beta_end: Weight = 0.1
    """The same at the end. The standardised latent's L1 starts near 0.8 and the spatial loss near 0.2, so that the depth leads
    at first and the latents count about half as much at the end."""
    commitment: Weight = 0.25
    """Weight of the VQ-VAEs' commitment loss; van den Oord et al. 2017."""


@configuration
class SsleTraining:
    """The training of `ssle` in all its stages; the defaults are the paper's where it gives a value."""

    vq: Schedule = Schedule(epochs=100, batch=4, accumulate=4, learning_rate=5e-5, final_learning_rate=5e-5, betas=(0.5, 0.9))
    """Of both VQ-VAEs. Rate, batch and accumulation are the paper's. It is the *base* rate there, which the reference framework
    multiplies by batch and accumulation, to 8e-4, by default; here it is taken as it is. Constant, with Adam's
    betas, as in the framework. The number of epochs is not in the paper."""
    unet: Schedule = Schedule(epochs=161, batch=4, learning_rate=1e-3, final_learning_rate=1e-6)
    """The paper's: 161 epochs, cosine with T_max 160."""
    loss: SsleLoss = SsleLoss()
    gain_range: GainRange = 0.0
    """Images are made brighter or darker by up to this fraction, and mirrored top to bottom; 0 for no augmentation, as in the
    paper, which mentions none."""
    tune_decoder: bool = False
    """Let the depth decoder learn on in the U-Net's stage."""
    variants: Annotated[int, Field(ge=0, le=1000)] = 0
    """Augmented variants of a frame in the U-Net's stage, whose codes are kept in memory (32 kB a variant and frame at a latent
    of 64x64) instead of running the frozen encoders at every step; 0 for a new one in every epoch and nothing kept."""


@configuration
class DualUNetTraining:
    """The training of `dual-unet`; its publication is not open, so that the defaults are those of the newer method's U-Net."""

    schedule: Schedule = Schedule(epochs=161, learning_rate=1e-3, final_learning_rate=1e-6)
    mask_weight: Weight = 0.1
    """Weight of MaskNet's cross-entropy beside DepthNet's errors, which are in units of the depth range."""
    square_weight: Weight = 1.0
    """Weight of the mean square error beside the mean absolute one."""
    gain_range: GainRange = 0.0
    """As in `SsleTraining`."""


def _muon(epochs: int) -> Schedule:
    return Schedule(
        epochs=epochs,
        batch=8,
        learning_rate=2e-3,
        final_learning_rate=1e-5,
        per_step=True,
        warmup_steps=200,
        optimizer="muon",
        weight_decay=1e-4,
        clip_norm=5.0,
        bfloat16=True,
    )


@configuration
class PhaseTraining:
    """The training of a network that reads the stripes' phase; see `phase_loss`."""

    schedule: Schedule = _muon(epochs=12)
    l1_weight: Weight = 0.3
    """Weight of the absolute error in millimetres beside the Laplace likelihood, which cares little for the worst pixels."""
    slip_weight: Weight = 3.0
    """Weight of the cross-entropy of being a slip; slips are rare, and each of them counts."""
    within_weight: Weight = 0.3
    """Weight of the cross-entropy of being within 1 mm."""
    gain_range: GainRange = 0.15
    """Images are made brighter or darker by up to this fraction."""
    painted_share: Share = 0.4
    """Fraction of the images that get a further texture."""
    max_slip: Share = 0.05
    """In validation, a pixel is valid where its predicted probability of being a slip is at most this."""


@configuration
class SslePhaseTraining:
    """The training of `ssle-phase` in its two stages."""

    reader: PhaseTraining = PhaseTraining()
    refiner: PhaseTraining = PhaseTraining(schedule=_muon(epochs=8))
