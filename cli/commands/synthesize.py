"""`laploop synthesize`: stripe frames with exact depth, of many tissues."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from laploop.cli.console import ResultTable
from laploop.cli.dataset import FRAMES, verify_dataset
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.errors import InvalidValueError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.store import SPLITS
from laploop.studies.training_frames import TrainingFramesConfig, render_training_frames


@dataclass(frozen=True, kw_only=True)
class SynthesizeArguments:
    """Render stripe frames of many tissues with exact depth, for training and evaluation.

    Writes the data set `frames.zarr` and `summary.json`. When it was stopped, the same command goes on where it was. With
    `--verify` it checks a data set instead.
    """

    frames: Annotated[TrainingFramesConfig, tyro.conf.arg(name="")] = field(default_factory=TrainingFramesConfig)
    out: Path | None = None
    """Folder to write to; made where it does not exist."""
    verify: Path | None = None
    """Check every frame of this data set, and render nothing."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(SynthesizeArguments, arguments, "synthesize")
    if chosen.verify is not None:
        return verify_dataset(chosen.verify)
    if chosen.out is None:
        raise InvalidValueError("--out", None, "a folder for the data set, or --verify and a data set")
    with OutputFolder(chosen.out, "synthesize") as folder:
        path = folder.path / FRAMES
        before = FrameStore.open(path).count_done() if path.exists() else 0
        render_training_frames(chosen.frames, path)
        store = FrameStore.open(path)
        tissues = {name: len(np.unique(store.tissue_seed[store.split == number])) for number, name in enumerate(SPLITS)}
        with_tool = int(store.tool_in_view.sum())
        results = {
            "frames": len(store),
            "frames_rendered_now": len(store) - before,
            "frames_with_tool": with_tool,
            "tissues": tissues,
        }
        folder.write_summary(results, config=chosen, seed=chosen.frames.seed)
    table = ResultTable(f"data set, seed {chosen.frames.seed}")
    table.row("frames", str(len(store)), f"{with_tool} with the instrument in view")
    for name, count in tissues.items():
        table.row(f"tissues, {name}", str(count))
    table.show(folder.path)
    return 0
