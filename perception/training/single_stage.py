"""Training of networks that learn in one stage."""

from collections.abc import Callable
from pathlib import Path
from typing import TypedDict, Unpack

from laploop.perception.data.datasets import DepthDataset
from laploop.perception.training.fit import Machine, check_fresh, fit, require_lightning
from laploop.perception.training.recipe import Recipe
from laploop.perception.training.samples import Samples, check_against, check_size


class TrainingOptions(TypedDict, total=False):
    """What may be said of any training."""

    against: str
    """`exact` (the default) or `zivid`, the depth to learn."""
    machine: Machine | None
    """What to train on."""
    limit: int | None
    """Largest number of frames of each split."""
    resume: bool
    """Go on from the checkpoint; off by default."""
    progress: bool
    """Show a bar; on by default."""


def train_single_stage(
    dataset: DepthDataset,
    out: Path,
    make_recipe: Callable[[], Recipe],
    *,
    size: tuple[int, int],
    **options: Unpack[TrainingOptions],
) -> Path:
    """Check everything, read the data, train, and return the path of the weights in `out`.

    Args:
        dataset: With a training and a validation split.
        out: Folder of weights, checkpoint and logs.
        make_recipe: Makes the recipe; called once everything is known to fit.
        size: Height and width of the images that the network takes.
        **options: See `TrainingOptions`.

    Raises:
        InvalidValueError: If the data set does not fit the network, or Lightning is not installed.
        OutputError: If `out` holds a training and `resume` is off.
    """
    against, limit = options.get("against", "exact"), options.get("limit")
    resume, progress = options.get("resume", False), options.get("progress", True)
    require_lightning()
    check_size(dataset, *size)
    check_against(dataset, against)
    check_fresh(out / "checkpoint.safetensors", resume=resume)
    recipe = make_recipe()
    train = Samples.read(dataset, "train", recipe, against=against, limit=limit, progress=progress)
    val = Samples.read(dataset, "val", recipe, against=against, limit=limit, progress=progress)
    return fit(recipe, train, val, out, machine=options.get("machine"), resume=resume, progress=progress)
