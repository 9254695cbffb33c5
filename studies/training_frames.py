"""Renders the frames that networks learn from, of many tissues, with exact depth."""

import multiprocessing
import signal
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from laploop.assets.phantom import TissueConfig
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import INSTRUMENT
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError, OutputError
from laploop.perception.frame_store import SPLITS, FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.frame_conditions import FrameRanges, draw_camera, draw_optics, draw_tool
from laploop.studies.training_scene import TrainingScene

_TISSUE_STREAM = 71
"""Keeps the tissues' random numbers apart from those of theatres, whose seeds are small integers too."""
_PRESS_TRAVEL_M = 0.006


@dataclass(frozen=True, kw_only=True)
class TrainingFramesConfig:
    """How many frames of how many tissues; no tissue is in two splits."""

    train_tissues: int = 150
    val_tissues: int = 10
    test_tissues: int = 20
    frames_per_tissue: int = 18
    tool_share: float = 0.5
    """Share of the frames with the instrument in view."""
    seed: int = 0
    workers: int = 2
    optics: ScopeOptics = field(default_factory=ScopeOptics)
    ranges: FrameRanges = field(default_factory=FrameRanges)

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidValueError: If a field lies outside its range.
        """
        for name in ("train_tissues", "val_tissues", "test_tissues"):
            if not 0 <= getattr(self, name) <= 100_000:
                raise InvalidValueError(name, getattr(self, name), "an integer from 0 to 100 000")
        if self.tissues == 0:
            raise InvalidValueError("number of tissues", 0, "at least 1 over the three splits")
        if self.frames_per_tissue < 1:
            raise InvalidValueError("frames_per_tissue", self.frames_per_tissue, "an integer from 1")
        if not 0.0 <= self.tool_share <= 1.0:
            raise InvalidValueError("tool_share", self.tool_share, "0 to 1")
        if self.seed < 0:
            raise InvalidValueError("seed", self.seed, "an integer from 0")
        if not 1 <= self.workers <= 256:
            raise InvalidValueError("workers", self.workers, "1 to 256 processes")

    @property
    def tissues(self) -> int:
        """Number of tissues in all."""
        return self.train_tissues + self.val_tissues + self.test_tissues

    @property
    def recipe(self) -> dict[str, object]:
        """What decides the frames' content, as plain data."""
        values = asdict(self)
        for name in ("workers", "optics"):
            del values[name]
        values["ranges"] = {
            name: list(value) if isinstance(value, tuple) else value for name, value in values["ranges"].items()
        }
        return values


def render_training_frames(config: TrainingFramesConfig, out: Path, *, progress: bool = True) -> Path:
    """Render a data set into the Zarr store `out` and return its path; goes on where an earlier run was stopped.

    Frame i depends on the configuration and i alone, not on the number of workers or on interruptions.

    Raises:
        OutputError: If `out` cannot be written or holds something else.
    """
    store = _open_or_create(config, out)
    todo = np.flatnonzero(~store.done())
    tissues = sorted({int(index) // config.frames_per_tissue for index in todo})
    with Progress(console=Console(stderr=True), disable=not progress) as bar:
        task = bar.add_task("frames", total=len(store), completed=len(store) - len(todo))
        if config.workers == 1:
            for tissue in tissues:
                bar.update(task, advance=_render_tissue(config, out, tissue))
        elif tissues:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(config.workers, context, initializer=_end_quietly_on_interrupt) as pool:
                jobs = [pool.submit(_render_tissue, config, out, tissue) for tissue in tissues]
                try:
                    for job in as_completed(jobs):
                        bar.update(task, advance=job.result())
                except BaseException:
                    pool.shutdown(wait=False, cancel_futures=True)
                    raise
    return out


def _end_quietly_on_interrupt() -> None:
    """Let Ctrl-C end a worker at once and without a word: the main process has one."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _open_or_create(config: TrainingFramesConfig, out: Path) -> FrameStore:
    if out.exists():
        store = FrameStore.open(out, writable=True)
        if store.config != config.recipe or store.optics != config.optics:
            raise OutputError(f"{out} holds a data set of another configuration; give a new folder")
        return store
    counts = [config.train_tissues, config.val_tissues, config.test_tissues]
    splits = np.repeat(np.arange(len(SPLITS), dtype=np.uint8), counts)
    frames = config.tissues * config.frames_per_tissue
    tool = np.array([_frame_rng(config, index).random() < config.tool_share for index in range(frames)])
    return FrameStore.create(
        out,
        optics=config.optics,
        tissue_seed=np.repeat(np.arange(config.tissues, dtype=np.int64), config.frames_per_tissue),
        split=np.repeat(splits, config.frames_per_tissue),
        tool_in_view=tool,
        config=config.recipe,
    )


def _frame_rng(config: TrainingFramesConfig, index: int) -> np.random.Generator:
    return np.random.default_rng([config.seed, _TISSUE_STREAM, 1, index])


def _render_tissue(config: TrainingFramesConfig, out: Path, tissue: int) -> int:
    """Render the missing frames of one tissue and return how many they were."""
    store = FrameStore.open(out, writable=True)
    first = tissue * config.frames_per_tissue
    done = store.done()
    todo = [index for index in range(first, first + config.frames_per_tissue) if not done[index]]
    tissue_rng = np.random.default_rng([config.seed, _TISSUE_STREAM, 0, tissue])
    scene = TrainingScene(TissueConfig(), tissue_rng)
    camera = StripeCamera(Rig.from_optics(config.optics), threads=1)
    camera.attach(scene.model, rng=tissue_rng)
    for index in todo:
        rng = _frame_rng(config, index)
        with_tool = rng.random() < config.tool_share
        scene.reset()
        pose = draw_camera(config.ranges, scene.mean_height_m, rng)
        if with_tool:
            tool = draw_tool(config.ranges, pose, scene.top_points(), tip_radius_m=INSTRUMENT.tip_radius_m, rng=rng)
            if tool.presses:
                scene.press_tool(tool.tip, tool.axis, travel_m=_PRESS_TRAVEL_M)
            else:
                scene.place_tool(tool.tip, tool.axis)
        camera.set_optics(draw_optics(config.ranges, pose.working_distance_m, rng))
        frame = camera.capture(scene.data, pose.world_from_camera, rng)
        store.write(index, image=frame.image, depth_mm=frame.depth_mm, lit=frame.lit)
    return len(todo)
