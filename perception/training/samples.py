"""Frames in memory, their order, and the batches made of them."""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.progress import track
from torch.utils.data import DataLoader, Dataset, Sampler

from laploop.errors import InvalidValueError
from laploop.perception.data.datasets import DepthDataset, ReferencedDataset
from laploop.perception.training.recipe import Batch, Recipe, Sample
from laploop.workers import follow_parent

AGAINST = ("exact", "zivid")
"""What may be the truth: the simulator's depth, or that of the reference camera after calibration and reprojection."""

Key = tuple[int, int]
"""Epoch and row of a sample; the epoch decides the augmentation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """The frames of one split that have any truth."""

    rows: list[Sample]
    split: str
    fingerprint: str
    """Hash of all arrays in their order: the same for the same frames, wherever they lie."""

    @classmethod
    def read(
        cls,
        dataset: DepthDataset,
        split: str,
        recipe: Recipe,
        *,
        against: str = "exact",
        limit: int | None = None,
        progress: bool = False,
    ) -> "Samples":
        """Read a split into memory, where training needs it hundreds of times; a frame is 320 kB and the recipe's extras.

        Args:
            dataset: An open data set.
            split: Which split.
            recipe: Says what else it needs of a frame.
            against: Which truth to learn, one of `AGAINST`.
            limit: Frames at most, spread evenly over the split; all if None.
            progress: Show a bar on the standard error stream.

        Raises:
            InvalidValueError: If the split is empty, the data set does not have that truth, a frame does not fit its optics,
                or no frame has any truth.
        """
        check_against(dataset, against)
        chosen = dataset.indices(split)
        if limit is not None and limit < len(chosen):
            chosen = chosen[np.linspace(0, len(chosen) - 1, limit).round().astype(np.intp)]
        size = (dataset.optics.height, dataset.optics.width)
        rows: list[Sample] = []
        digest = hashlib.blake2b(digest_size=8)
        for index in track(chosen, f"reading {split}", console=Console(stderr=True), disable=not progress):
            sample = _read(dataset, int(index), against)
            _check_frame(dataset, int(index), sample, size)
            if np.isfinite(sample["depth_mm"]).any():
                rows.append({**sample, **recipe.extras(dataset, int(index))})
                for values in rows[-1].values():
                    digest.update(np.ascontiguousarray(values).data)
        if not rows:
            raise InvalidValueError(f"frames with any depth in split {split!r} of {dataset.path}", 0, "1 or more")
        return cls(rows=rows, split=split, fingerprint=digest.hexdigest())

    def __len__(self) -> int:
        return len(self.rows)


def check_against(dataset: DepthDataset, against: str) -> None:
    """Raise an `InvalidValueError` for a truth that the data set does not have."""
    exact, reference = dataset.has_exact, isinstance(dataset, ReferencedDataset)
    allowed = [truth for truth, there in zip(AGAINST, (exact, reference), strict=True) if there]
    if against not in allowed:
        note = "" if reference else "; only pairs of `laploop collect` or `laploop import-pairs` have a reference camera"
        note += "" if exact else "; pairs of a real bench have no exact depth"
        raise InvalidValueError(f"truth to learn from {dataset.path}", against, ", ".join(allowed) + note)


def _read(dataset: DepthDataset, index: int, against: str) -> Sample:
    if against == "zivid" and isinstance(dataset, ReferencedDataset):
        return {"image": dataset.image(index), "depth_mm": dataset.reference_depth_mm(index)}
    return {"image": dataset.image(index), "depth_mm": dataset.depth_mm(index)}


def _check_frame(dataset: DepthDataset, index: int, sample: Sample, size: tuple[int, int]) -> None:
    image, depth_mm = sample["image"], sample["depth_mm"]
    where = f"of frame {index} of {dataset.path}"
    if image.dtype != np.uint8:
        raise InvalidValueError(f"type of the image {where}", str(image.dtype), "uint8")
    if image.shape != size or depth_mm.shape != size:
        raise InvalidValueError(f"shapes of image and depth {where}", (image.shape, depth_mm.shape), f"both {size}")
    if np.any(depth_mm <= 0.0):
        raise InvalidValueError(f"smallest depth {where}", float(np.nanmin(depth_mm)), "above 0 mm, or NaN for none")


class SampleDataset(Dataset[Sample]):
    """Hands whole batches to torch's loader, augmented by the recipe in training."""

    def __init__(self, samples: Samples, recipe: Recipe, *, training: bool) -> None:
        self._rows = samples.rows
        self._recipe = recipe
        self._training = training
        self._derived: dict[Key, Sample] = {}

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, key: Key) -> Sample:
        """Return a frame as it is in an epoch; the same key gives the same bits."""
        epoch, row = key
        sample, variants = self._rows[row], self._recipe.variants
        draw = epoch % variants if variants else epoch
        if self._training:
            rng = np.random.default_rng([self._recipe.schedule.seed, draw, row])
            sample = self._recipe.augment(sample, rng)
        if not variants:
            return sample
        kept = (draw if self._training else 0, row)
        if kept not in self._derived:
            self._derived[kept] = self._recipe.derive(sample)
        return {**sample, **self._derived[kept]}


def stack(samples: Sequence[Sample]) -> Batch:
    """Stack samples to a batch; images become float32."""
    batch = {key: torch.from_numpy(np.stack([sample[key] for sample in samples])) for key in samples[0]}
    batch["image"] = batch["image"].to(torch.float32)
    return batch


class EpochSampler(Sampler[Key]):
    """Keys in an order that depends on seed and epoch alone.

    Several processes get every n-th key each, and the first keys once more where the frames do not divide, so that all have
    the same number.
    """

    def __init__(self, frames: int, *, seed: int, shuffle: bool, rank: int = 0, processes: int = 1) -> None:
        self._frames, self._seed, self._shuffle = frames, seed, shuffle
        self._rank, self._processes = rank, processes
        self._epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch; Lightning calls this."""
        self._epoch = epoch

    def __len__(self) -> int:
        return math.ceil(self._frames / self._processes)

    def __iter__(self) -> Iterator[Key]:
        order = np.arange(self._frames)
        if self._shuffle:
            order = np.random.default_rng([self._seed, self._epoch]).permutation(self._frames)
        order = np.resize(order, len(self) * self._processes)
        for row in order[self._rank :: self._processes]:
            yield self._epoch, int(row)


def loader(
    samples: Samples, recipe: Recipe, *, training: bool, epoch: int = 0, workers: int = 0, rank: int = 0, processes: int = 1
) -> DataLoader[Any]:
    """Return batches of samples from an epoch on, for one of several processes; shuffled and augmented in training."""
    seed = recipe.schedule.seed
    sampler = EpochSampler(len(samples), seed=seed, shuffle=training, rank=rank, processes=processes)
    # Worker processes fetch their first batches before Lightning sets the epoch of a resumed training.
    sampler.set_epoch(epoch)
    frames: Any = SampleDataset(samples, recipe, training=training)
    return DataLoader(
        frames,
        batch_size=recipe.schedule.batch,
        sampler=sampler,
        collate_fn=stack,
        num_workers=workers,
        worker_init_fn=_begin_worker,
    )


def _begin_worker(_number: int) -> None:
    follow_parent()
