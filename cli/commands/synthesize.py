"""`laploop synthesize`: stripe frames with exact depth, of many tissues."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.dataset import FRAMES, SCOPE, verify_dataset
from laploop.cli.output import OutputFolder
from laploop.cli.parsing import Inlined, parse
from laploop.cli.tree_options import FileOptions
from laploop.errors import InvalidValueError
from laploop.studies.synthesis.config import TrainingFramesConfig


@dataclass(frozen=True, kw_only=True)
class SynthesizeArguments:
    """Render stripe frames of many tissues, or of anatomy of many families, with exact depth, for training and evaluation.

    Writes the data set `frames.zarr`, the nominal scope `scope.json` (for `laploop predict`) and `summary.json`. When it was
    stopped, the same command goes on where it was. With `--verify` it checks a data set instead. Of a configuration file it
    takes the scope.
    """

    frames: Inlined[TrainingFramesConfig] = field(default_factory=TrainingFramesConfig)
    file: Inlined[FileOptions] = field(default_factory=FileOptions)
    out: Path | None = None
    """Folder to write to; made where it does not exist."""
    verify: Path | None = None
    """Check every frame of this data set, and render nothing."""


def read_arguments(arguments: Sequence[str]) -> SynthesizeArguments:
    """Read the arguments; options come before what the configuration file holds."""
    chosen = parse(SynthesizeArguments, arguments, "synthesize")
    if (loop := chosen.file.loop()) is not None:
        frames = replace(chosen.frames, optics=loop.theatre.scope)
        chosen = parse(SynthesizeArguments, arguments, "synthesize", replace(chosen, frames=frames))
    return chosen


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = read_arguments(arguments)
    if chosen.verify is not None:
        return verify_dataset(chosen.verify)
    if chosen.out is None:
        raise InvalidValueError("--out", None, "a folder for the data set, or --verify and a data set")

    from laploop.perception.calibration.scope_rig import save_design
    from laploop.perception.data.frame_store import FrameStore
    from laploop.studies.synthesis.run import render_training_frames  # slow to import

    config = chosen.frames
    with OutputFolder(chosen.out, "synthesize") as folder:
        path = folder.path / FRAMES
        before = FrameStore.open(path).count_done() if path.exists() else 0
        with progress_bar("frames", config.frames) as report:
            render_training_frames(config, path, report=report)
        store = FrameStore.open(path)
        tissues, with_tool = store.tissues_by_split(), int(store.tool_in_view.sum())
        results = {
            "frames": len(store),
            "frames_rendered_now": len(store) - before,
            "frames_with_tool": with_tool,
            "tissues": tissues,
            "families": store.tissues_by_family(),
        }
        with folder.artefact(SCOPE) as partial:
            save_design(partial, store.optics)
        folder.write_summary(results, config=chosen, seed=config.seed)
    table = ResultTable(f"data set, seed {config.seed}")
    table.row("frames", str(len(store)), f"{with_tool} with the instrument in view")
    for name, count in tissues.items():
        table.row(f"tissues, {name}", str(count))
    table.show(folder.path)
    return 0
