"""Renders the frames that networks learn from, of many tissues, with exact depth."""

from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.shafts import INSTRUMENT
from laploop.assets.tissue_appearance import AppearanceRanges, TissueAppearance, draw_appearance
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.optics.scope_ranges import ScopeRanges, draw_scope
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import InvalidValueError, OutputError, check_range
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.store import SPLITS
from laploop.perception.geometry import Rig
from laploop.studies.scenes.frame_conditions import CameraPose, FrameRanges, draw_camera, draw_optics, draw_tool
from laploop.studies.scenes.hard_conditions import ill_exposure, place_large_tool
from laploop.studies.scenes.training_scene import TrainingScene
from laploop.workers import run_in_workers

_TISSUE_STREAM = 71
"""Keeps the tissues' random numbers apart from those of theatres, whose seeds are small integers too."""
_PRESS_TRAVEL_M = 0.006
_ILL_EXPOSED_SHARES = (0.1, 0.5)
_ADDED_LATER = (
    "randomised_scopes",
    "scope_ranges",
    "randomised_appearances",
    "appearance_ranges",
    "large_tool_share",
    "ill_exposed_share",
)
"""Not in the recipe where they change nothing, so that data sets made before they existed can still be gone on with."""


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
    randomised_scopes: float = 0.0
    """Share of the tissues that are seen through a scope of their own, drawn from `scope_ranges`."""
    scope_ranges: ScopeRanges = field(default_factory=ScopeRanges)
    randomised_appearances: float = 0.0
    """Fraction of the tissues with patches and detail drawn from `appearance_ranges`."""
    appearance_ranges: AppearanceRanges = field(default_factory=AppearanceRanges)
    large_tool_share: float = 0.0
    """Share of the frames with the instrument in which it covers a large part of the view."""
    ill_exposed_share: float = 0.0
    """Share of the frames in which a tenth to half of the pixels are saturated, or dark."""

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
        for name in ("tool_share", "randomised_scopes", "randomised_appearances", "large_tool_share", "ill_exposed_share"):
            check_range(name, getattr(self, name), 0.0, 1.0)
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
        if self.randomised_scopes == 0.0:
            del values["scope_ranges"]
        if self.randomised_appearances == 0.0:
            del values["appearance_ranges"]
        for item in fields(self):
            if item.name in _ADDED_LATER and item.name in values and getattr(self, item.name) == item.default:
                del values[item.name]
        for name in ("ranges", "scope_ranges", "appearance_ranges"):
            if name in values:
                values[name] = {key: list(value) if isinstance(value, tuple) else value for key, value in values[name].items()}
        return values

    def scope_of(self, tissue: int) -> ScopeOptics:
        """Return the scope through which a tissue is seen."""
        rng = np.random.default_rng([self.seed, _TISSUE_STREAM, 2, tissue])
        drawn = self.randomised_scopes > 0.0 and rng.random() < self.randomised_scopes
        return draw_scope(self.optics, rng, self.scope_ranges) if drawn else self.optics

    def appearance_of(self, tissue: int) -> TissueAppearance:
        """Return what a tissue looks like."""
        rng = np.random.default_rng([self.seed, _TISSUE_STREAM, 3, tissue])
        drawn = rng.random() < self.randomised_appearances
        return draw_appearance(rng, self.appearance_ranges) if drawn else TissueAppearance()


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

        def rendered(_tissue: int, frames: int) -> None:
            bar.update(task, advance=frames)

        run_in_workers(partial(_render_tissue, config, out), tissues, config.workers, rendered)
    return out


def _open_or_create(config: TrainingFramesConfig, out: Path) -> FrameStore:
    if out.exists():
        store = FrameStore.open(out, writable=True)
        if store.config != config.recipe or store.optics != config.optics:
            raise OutputError(f"{out} holds a data set of another configuration; give a new folder")
        store.remove_left_behind()
        return store
    counts = [config.train_tissues, config.val_tissues, config.test_tissues]
    splits = np.repeat(np.arange(len(SPLITS), dtype=np.uint8), counts)
    frames = config.tissues * config.frames_per_tissue
    tool = np.array([_frame_rng(config, index).random() < config.tool_share for index in range(frames)])
    tissue = np.repeat(np.arange(config.tissues), config.frames_per_tissue)
    scopes = [config.scope_of(number) for number in range(config.tissues)]
    varied = any(scope != config.optics for scope in scopes)
    return FrameStore.create(
        out,
        optics=config.optics,
        scopes=scopes if varied else (),
        scope=tissue.astype(np.int32) if varied else None,
        tissue_seed=tissue.astype(np.int64),
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
    camera = StripeCamera(Rig.from_optics(config.scope_of(tissue)), threads=1)
    camera.attach(scene.model, rng=tissue_rng, appearance=config.appearance_of(tissue))
    for index in todo:
        rng = _frame_rng(config, index)
        with_tool = rng.random() < config.tool_share
        scene.reset()
        pose = draw_camera(config.ranges, scene.mean_height_m, rng)
        if with_tool:
            _place_tool(config, scene, camera, pose, rng)
        optics = draw_optics(config.ranges, pose.working_distance_m, rng)
        camera.set_optics(optics)
        # What is off must not draw: the frames of older data sets would change.
        if config.ill_exposed_share > 0.0 and rng.random() < config.ill_exposed_share:
            expected = camera.capture(scene.data, pose.world_from_camera, None).electrons
            share = rng.uniform(*_ILL_EXPOSED_SHARES)
            camera.set_optics(ill_exposure(expected, optics, share, saturated=index % 2 == 0))
        frame = camera.capture(scene.data, pose.world_from_camera, rng)
        store.write(index, image=frame.image, depth_mm=frame.depth_mm, lit=frame.lit)
    return len(todo)


def _place_tool(
    config: TrainingFramesConfig, scene: TrainingScene, camera: StripeCamera, pose: CameraPose, rng: np.random.Generator
) -> None:
    if config.large_tool_share > 0.0 and rng.random() < config.large_tool_share:
        place_large_tool(scene, camera, pose, rng)
        return
    tool = draw_tool(config.ranges, pose, scene.top_points(), tip_radius_m=INSTRUMENT.tip_radius_m, rng=rng)
    if tool.presses:
        scene.press_tool(tool.tip, tool.axis, travel_m=_PRESS_TRAVEL_M)
    else:
        scene.place_tool(tool.tip, tool.axis)
