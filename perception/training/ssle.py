"""Training of the paper's network in its three stages: VQ-VAE of images, VQ-VAE of depths, U-Net between their latents."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from laploop.configuration import to_plain
from laploop.perception.networks.configs import SsleConfig
from laploop.perception.networks.ssle_network import SsleNetwork, SsleOutput
from laploop.perception.networks.vq_vae import VqVae, depth_to_unit, image_to_unit, unit_to_depth
from laploop.perception.training.losses import linear_ramp, masked_l1, spatial_loss, vq_loss
from laploop.perception.training.recipe import Batch, Loss, Prediction, Recipe, Sample, seeded
from laploop.perception.training.run import TrainingRun
from laploop.perception.training.samples import SampleDataset, Samples, stack
from laploop.perception.training.settings import SsleTraining


class VqRecipe(Recipe):
    """One VQ-VAE: reconstruction error plus the quantiser's losses.

    The reference framework adds a perceptual and an adversarial loss, made for photographs; depth and stripes are measured in
    millimetres and phase, which L1 asks for directly.
    """

    def __init__(self, domain: str, config: SsleConfig, training: SsleTraining) -> None:
        """Make a VQ-VAE of the `image` or the `depth` domain with random weights that depend on the seed alone."""
        self.name = f"vq-{domain}"
        self.error_unit = "grey" if domain == "image" else "mm"
        self.schedule, self.gain_range = training.vq, training.gain_range
        self.settings = _settings(training)
        self.config: SsleConfig = config
        self._domain, self._training = domain, training
        self.vq_vae = seeded(lambda: VqVae(config.image if domain == "image" else config.depth), training.vq.seed)
        self.network = self.vq_vae

    @property
    def architecture(self) -> Mapping[str, object]:
        """The whole network's, and which part this is."""
        return {**self.config.architecture, "format": f"{self.config.form}-{self.name}"}

    def loss(self, batch: Batch, progress: float) -> Loss:  # noqa: ARG002 - the weights do not change
        """Return L1 of the reconstruction, over pixels with a depth in the depth domain, plus the quantiser's loss."""
        unit, mask = self.unit(batch)
        with self.autocast(unit.device):
            rebuilt, quantized = self.vq_vae(unit)
        rebuilding = masked_l1(rebuilt.float(), unit, mask)
        quantizing = vq_loss(quantized.codebook_loss, quantized.commitment_loss, self._training.loss.commitment)
        parts = {"rebuilding": rebuilding, "quantizing": quantizing, "perplexity": quantized.perplexity}
        return Loss(total=rebuilding + quantizing, parts=parts)

    def predict(self, batch: Batch) -> Prediction:
        """Return the reconstruction; of images, grey values in the place of millimetres."""
        unit, mask = self.unit(batch)
        with self.autocast(unit.device):
            rebuilt, _ = self.vq_vae(unit)
        return Prediction(depth_mm=unit_to_depth(rebuilt, self._farthest), valid=mask[:, 0])

    def truth_mm(self, batch: Batch) -> Tensor:
        """Return what is to be reconstructed."""
        return batch["image"] if self._domain == "image" else batch["depth_mm"]

    @property
    def _farthest(self) -> float:
        return 255.0 if self._domain == "image" else self.config.farthest_mm

    def unit(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Return the domain's values (B, 1, H, W) in -1 to 1, and where they are known."""
        if self._domain == "image":
            unit = image_to_unit(batch["image"])
            return unit, torch.ones_like(unit, dtype=torch.bool)
        known = torch.isfinite(batch["depth_mm"])[:, None]
        return depth_to_unit(batch["depth_mm"], self.config.farthest_mm), known


class UNetRecipe(Recipe):
    """The U-Net between pretrained latents: spatial loss plus ramped latent loss."""

    name = "ssle"

    def __init__(
        self, config: SsleConfig, training: SsleTraining, image: VqVae, depth: VqVae, statistics: tuple[Tensor, Tensor]
    ) -> None:
        """Put the network together from trained VQ-VAEs, and mean and deviation of the depth's quantised latents."""
        self.config: SsleConfig = config
        self.schedule, self.gain_range = training.unet, training.gain_range
        self.settings = _settings(training)
        self.variants = training.variants
        self._training = training
        self.ssle = seeded(lambda: SsleNetwork(config), training.unet.seed)
        self.ssle.take_pretrained(image, depth, *statistics)
        self.network = self.ssle
        # Not part of the network that is saved: it is needed for the target alone.
        self._target = depth.eval().requires_grad_(requires_grad=False)
        for part in (self.ssle.encoder, self.ssle.quantizer, self.ssle.depth_quantizer):
            part.requires_grad_(requires_grad=False)
        self.ssle.decoder.requires_grad_(requires_grad=training.tune_decoder)

    def loss(self, batch: Batch, progress: float) -> Loss:
        """Return the paper's total loss."""
        weights, farthest = self._training.loss, self.config.farthest_mm
        truth = batch["depth_mm"]
        # Codebooks that are done must not count or move.
        self.ssle.quantizer.eval()
        self.ssle.depth_quantizer.eval()
        with self.autocast(truth.device):
            output = self._output(batch)
            with torch.no_grad():
                target = self._latent(batch)
        mask = torch.isfinite(truth)
        spatial, l1, unlike = spatial_loss(output.depth_mm, truth, mask, alpha=weights.alpha, farthest_mm=farthest)
        latent = (output.latent - self.ssle.standardize(target)).abs().mean()
        total = spatial + linear_ramp(weights.beta_start, weights.beta_end, progress) * latent
        return Loss(total=total, parts={"mae_mm": l1 * farthest, "unlike": unlike, "latent": latent})

    def predict(self, batch: Batch) -> Prediction:
        """Return the depth; the network has no confidence of its own."""
        with self.autocast(batch["image"].device):
            depth_mm = self._output(batch).depth_mm
        return Prediction(depth_mm=depth_mm, valid=torch.ones_like(depth_mm, dtype=torch.bool))

    def derive(self, sample: Sample) -> Sample:
        """Return which entries of the codebooks stand for the image and for the depth, (h, w) each.

        The frozen layers run in evaluation mode, in single precision and on one frame at a time, so that the entries are the
        same whatever else is in a batch.
        """
        device = next(self.ssle.parameters()).device
        image = torch.from_numpy(np.ascontiguousarray(sample["image"]))[None].to(device, torch.float32)
        depth_mm = torch.from_numpy(np.ascontiguousarray(sample["depth_mm"]))[None].to(device)
        target = self._target.to(device)
        with torch.no_grad():
            codes = self.ssle.quantizer.lookup(self.ssle.encoder(image_to_unit(image)))
            unit = depth_to_unit(depth_mm, self.config.farthest_mm)
            target_codes = target.quantizer.lookup(target.encoder(unit))
        return {"codes": codes[0].int().cpu().numpy(), "target_codes": target_codes[0].int().cpu().numpy()}

    def _output(self, batch: Batch) -> SsleOutput:
        if "codes" in batch:
            return self.ssle.from_codes(self.ssle.quantizer.decode(batch["codes"]))
        output: SsleOutput = self.ssle(batch["image"])
        return output

    def _latent(self, batch: Batch) -> Tensor:
        target = self._target.to(batch["depth_mm"].device)
        if "target_codes" in batch:
            return target.quantizer.decode(batch["target_codes"])
        values: Tensor = target.quantizer(target.encoder(depth_to_unit(batch["depth_mm"], self.config.farthest_mm))).values
        return values


def train_ssle(run: TrainingRun, *, config: SsleConfig, training: SsleTraining) -> Path:
    """Train all stages and return the path of the weights; each VQ-VAE has a folder of its own."""
    image, depth = VqRecipe("image", config, training), VqRecipe("depth", config, training)
    frames = run.read(image)
    for recipe in (image, depth):
        run.fit(recipe, frames, recipe.name)
    unet = UNetRecipe(config, training, image.vq_vae, depth.vq_vae, latent_statistics(depth, frames[0]))
    return run.fit(unet, frames)


def _settings(training: SsleTraining) -> Mapping[str, object]:
    """Return all but the epochs of the last stage, which may be changed on resume."""
    plain = to_plain(training)
    del plain["unet"]["epochs"]
    return plain


def latent_statistics(recipe: VqRecipe, samples: Samples) -> tuple[Tensor, Tensor]:
    """Return mean and deviation (d,) of the quantised latents of a domain over samples, without augmentation."""
    frames = SampleDataset(samples, recipe, training=False)
    network = recipe.vq_vae.eval()
    total = torch.zeros(2, network.config.latent, dtype=torch.float64)
    with torch.inference_mode():
        for row in range(len(samples)):
            unit, _ = recipe.unit(stack([frames[0, row]]))
            with recipe.autocast(unit.device):
                values = network.quantizer(network.encoder(unit)).values.double()
            total += torch.stack([values.mean(dim=(0, 2, 3)), values.square().mean(dim=(0, 2, 3))])
    mean, square = total / len(samples)
    return mean.float(), (square - mean.square()).clamp(min=0.0).sqrt().float()
