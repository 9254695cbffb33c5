"""`laploop synthesize`: stripe frames with exact depth, of many tissues."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from laploop.cli.console import ResultTable
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import parse
from laploop.perception.data.frame_store import SPLITS, FrameStore
from laploop.studies.training_frames import TrainingFramesConfig, render_training_frames

STORE = "frames.zarr"
"""Name of the data set inside the output folder."""


@dataclass(frozen=True, kw_only=True)
class SynthesizeArguments:
    """Render stripe frames of many tissues with exact depth, for training and evaluation.

    Writes the data set `frames.zarr` and `summary.json`. When it was stopped, the same command goes on where it was.
    """

    frames: Annotated[TrainingFramesConfig, tyro.conf.arg(name="")] = field(default_factory=TrainingFramesConfig)
    out: Path
    """Folder to write to; made where it does not exist."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(SynthesizeArguments, arguments, "synthesize")
    with OutputFolder(chosen.out, "synthesize") as folder:
        path = folder.path / STORE
        before = int(FrameStore.open(path).done().sum()) if path.exists() else 0
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
