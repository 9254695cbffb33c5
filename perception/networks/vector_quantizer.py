"""Vector quantisation: every latent vector is replaced by the nearest entry of a learned codebook.

Our own instead of a library's: exact, deterministic (ties go to the lower index, no random numbers), a matrix product and a
gather when exported, and weights that are a plain table. The codebook learns by gradient, as in the framework that the paper
names, not by a running mean.
"""

from contextlib import nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True, eq=False)
class Quantized:
    """The quantiser's output for a batch."""

    values: Tensor
    """(B, d, H, W), codebook entries; their gradient goes straight through to the latents that they replace."""
    indices: Tensor
    """(B, H, W) int64, which entries."""
    codebook_loss: Tensor
    """Mean squared distance that pulls the entries to the latents."""
    commitment_loss: Tensor
    """The same distance, pulling the latents to the entries."""
    perplexity: Tensor
    """exp of the entropy of the entries' use in this batch: 1 when one entry serves all, at most the number of entries."""


class VectorQuantizer(nn.Module):
    """A codebook of `entries` vectors of `dimension` numbers.

    An entry that no latent chose for `restart_after` training batches is moved onto a latent of the current batch; at the first
    batch all entries are. Which latents is fixed by a counter, not drawn, so that a resumed training repeats it; with several
    processes the first one's choice is broadcast. The reference framework restarts nothing and leaves most of a codebook
    unused on maps as smooth as depth; `restart_after` 0 does the same.
    """

    def __init__(self, entries: int, dimension: int, *, restart_after: int = 64) -> None:
        """Make a codebook, uniform in +-1 / entries.

        Raises:
            InvalidValueError: If there are fewer than two entries, no dimension, or `restart_after` is negative.
        """
        super().__init__()
        if entries < 2 or dimension < 1 or restart_after < 0:
            values = (entries, dimension, restart_after)
            raise InvalidValueError("entries, dimension, restart_after", values, "2 or more, 1 or more, 0 or more")
        self.restart_after = restart_after
        self.codebook = nn.Parameter(torch.empty(entries, dimension).uniform_(-1.0 / entries, 1.0 / entries))
        self.idle = nn.Buffer(torch.full((entries,), restart_after, dtype=torch.int32))
        """(entries,), training batches since an entry was chosen."""
        self.batches = nn.Buffer(torch.zeros((), dtype=torch.int64))

    def lookup(self, latents: Tensor) -> Tensor:
        """Return the index of the nearest entry (B, H, W) for latents (B, d, H, W)."""
        rows = latents.float().movedim(1, -1)
        # |z - e|^2 without the term that is the same for all entries; in one pass, since the matrix is large.
        squares = self.codebook.square().sum(dim=1)
        distance = torch.addmm(squares, rows.flatten(0, 2), -2.0 * self.codebook.T)
        return distance.argmin(dim=-1).reshape(rows.shape[:-1])

    def decode(self, indices: Tensor) -> Tensor:
        """Return the entries (B, d, H, W) at indices (B, H, W)."""
        return functional.embedding(indices, self.codebook).movedim(-1, 1)

    def forward(self, latents: Tensor) -> Quantized:
        """Quantise latents (B, d, H, W); in float32 whatever is around it, since nearest neighbours are a close call."""
        device = latents.device.type
        # Meta tensors, which only count sizes, know no autocast.
        with nullcontext() if device == "meta" else torch.autocast(device_type=device, enabled=False):
            latents = latents.float()
            if self.training and self.restart_after:
                self._restart(latents.detach())
            indices = self.lookup(latents.detach())
            if self.training and self.restart_after:
                self._count(indices)
            entries = self.decode(indices)
            # Sums of ones, where a one-hot matrix of all latents would be hundreds of megabytes.
            ones = torch.ones(indices.numel(), device=indices.device)
            used = torch.zeros(len(self.codebook), device=indices.device).scatter_add(0, indices.flatten(), ones) / len(ones)
            return Quantized(
                values=latents + (entries - latents).detach(),
                indices=indices,
                codebook_loss=(entries - latents.detach()).square().mean(),
                commitment_loss=(entries.detach() - latents).square().mean(),
                perplexity=torch.exp(-(used * torch.log(used + 1e-10)).sum()),
            )

    @torch.no_grad()
    def _count(self, indices: Tensor) -> None:
        self.idle.add_(1)
        self.idle[torch.bincount(indices.flatten(), minlength=len(self.idle)) > 0] = 0
        self.batches.add_(1)
        self._agree()

    @torch.no_grad()
    def _restart(self, latents: Tensor) -> None:
        dead = torch.nonzero(self.idle >= self.restart_after).flatten()
        if len(dead):
            rows = latents.movedim(1, -1).flatten(0, 2)
            # Steps of the golden ratio spread the choice evenly over the batch, whatever the number of dead entries.
            place = (torch.arange(1, len(dead) + 1, device=rows.device) + self.batches) * 0.6180339887498949
            self.codebook[dead] = rows[((place % 1.0) * len(rows)).long().clamp(max=len(rows) - 1)]
            self.idle[dead] = 0
            self._agree()

    def _agree(self) -> None:
        """Take over the first process's codebook and counters where several train together."""
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            for tensor in (self.codebook.data, self.idle, self.batches):
                torch.distributed.broadcast(tensor, src=0)
