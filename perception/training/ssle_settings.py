"""Weights of the losses and schedules of the paper's network; the paper's values where it gives them."""

from dataclasses import dataclass, field

from laploop.errors import InvalidValueError, UnknownNameError, check_range
from laploop.perception.training.recipe import Schedule


@dataclass(frozen=True, kw_only=True)
class SsleLoss:
    """Weights that the paper names without a value; each default is a choice of ours."""

    alpha: float = 0.84
    """Share of L1; the rest is SSIM's. Zhao et al. 2017 give SSIM 0.84 for pictures; here the millimetres count."""
    beta_start: float = 0.01
    """Weight of the latent L1 at the start of the U-Net's training."""
    beta_end: float = 0.1
    """The same at the end. The standardised latent's L1 starts near 0.8 and the spatial loss near 0.2, so that the depth leads
    at first and the latents count about half as much at the end."""
    commitment: float = 0.25
    """Weight of the VQ-VAEs' commitment loss; van den Oord et al. 2017."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If alpha is not a share or a weight is negative.
        """
        check_range("alpha", self.alpha, 0.0, 1.0)
        for name in ("beta_start", "beta_end", "commitment"):
            if not getattr(self, name) >= 0.0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")


@dataclass(frozen=True, kw_only=True)
class SsleTraining:
    """The schedule of all stages; the defaults are the paper's where it gives a value."""

    vq: Schedule = field(
        default_factory=lambda: Schedule(
            epochs=100, batch=4, accumulate=4, learning_rate=5e-5, final_learning_rate=5e-5, betas=(0.5, 0.9)
        )
    )
    """Of both VQ-VAEs. Rate, batch and accumulation are the paper's. It is the *base* rate there, which the reference framework
    multiplies by batch and accumulation, to 8e-4, unless told not to; here it is taken as it stands. Constant, with Adam's
    betas, as in the framework. The number of epochs is not in the paper."""
    unet: Schedule = field(default_factory=lambda: Schedule(epochs=161, batch=4, learning_rate=1e-3, final_learning_rate=1e-6))
    """The paper's: 161 epochs, cosine with T_max 160."""
    loss: SsleLoss = field(default_factory=SsleLoss)
    gain_range: float = 0.0
    """Images are made brighter or darker by up to this share, and mirrored top to bottom; 0 for no augmentation, as in the
    paper, which tells of none."""
    tune_decoder: bool = False
    """Let the depth decoder learn on in the U-Net's stage."""
    variants: int = 0
    """Augmented variants of a frame in the U-Net's stage, whose codes are kept in memory (32 kB a variant and frame at a latent
    of 64x64) instead of running the frozen encoders at every step; 0 for a new one in every epoch and nothing kept."""

    def __post_init__(self) -> None:
        """Check what the parts do not check themselves.

        Raises:
            InvalidValueError: If a number is negative.
        """
        for name in ("gain_range", "variants"):
            if not getattr(self, name) >= 0:
                raise InvalidValueError(name, getattr(self, name), "0 or more")

    @classmethod
    def named(cls, size: str) -> "SsleTraining":
        """Return the schedule for a named size of the network.

        Raises:
            UnknownNameError: If there is no such size.
        """
        if size not in _TRAININGS:
            raise UnknownNameError("size of ssle", size, _TRAININGS)
        return _TRAININGS[size]


_TRAININGS = {
    "paper": SsleTraining(),
    "small": SsleTraining(
        # In float32: group normalisation casts back and forth, so that bfloat16 makes a step of these slower, not faster.
        vq=Schedule(epochs=9, learning_rate=2e-3, final_learning_rate=1e-5, per_step=True, warmup_steps=20, clip_norm=5.0),
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
    "tiny": SsleTraining(
        vq=Schedule(epochs=2, batch=2, learning_rate=2e-3, final_learning_rate=1e-4),
        unet=Schedule(epochs=2, batch=2, learning_rate=2e-3, final_learning_rate=1e-5),
    ),
}
