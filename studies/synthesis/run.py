"""Renders training frames of many tissues, with exact depth."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from laploop.assets.anatomy.distance_grid import require_scikit_image
from laploop.assets.anatomy.families.registry import TISSUE_FAMILY
from laploop.assets.shafts import INSTRUMENT
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.errors import OutputError
from laploop.perception.data.dataset import SPLITS
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.scenes.frame_conditions import CameraPose, draw_camera, draw_optics, draw_tool
from laploop.studies.scenes.hard_conditions import place_large_tool
from laploop.studies.scenes.light_variety import draw_response, draw_subsurface
from laploop.studies.scenes.training_scene import TrainingScene
from laploop.studies.synthesis.anatomy_frames import render_anatomy
from laploop.studies.synthesis.capture import write_frame
from laploop.studies.synthesis.config import TrainingFramesConfig
from laploop.workers import run_in_workers

_PRESS_TRAVEL_M = 0.006


def render_training_frames(config: TrainingFramesConfig, out: Path, *, report: Callable[[int], None] = lambda _: None) -> Path:
    """Render a data set into the store `out` and return its path; resume where an earlier run stopped.

    Frame i depends on the configuration and i alone, not on the number of workers or on interruptions. `report` is called with
    the number of frames done so far.

    Raises:
        OutputError: If `out` cannot be written or holds a data set of another configuration.
        InvalidValueError: If it is to show anatomy and scikit-image (extra `mesh`) is not installed.
        DatasetError: If `out` holds something else.
    """
    store = _open_or_create(config, out)
    done = store.done()
    tissues = sorted({int(index) // config.frames_per_tissue for index in np.flatnonzero(~done)})
    count = int(done.sum())
    report(count)

    def rendered(_tissue: int, frames: int) -> None:
        nonlocal count
        count += frames
        report(count)

    run_in_workers(partial(_render_tissue, config, out), tissues, config.workers, rendered)
    return out


def _open_or_create(config: TrainingFramesConfig, out: Path) -> FrameStore:
    if out.exists():
        store = FrameStore.open(out, writable=True)
        if store.config != config.recipe or store.optics != config.optics:
            raise OutputError(f"{out} holds a data set of another configuration; give a new folder")
        store.remove_left_behind()
        return store
    tissue = np.repeat(np.arange(config.tissues), config.frames_per_tissue)
    counts = (config.train_tissues, config.val_tissues, config.test_tissues)
    worlds = [config.world_of(number) for number in range(config.tissues)]
    if any(world.family != TISSUE_FAMILY for world in worlds):
        require_scikit_image()
    families, family = np.unique([world.family for world in worlds], return_inverse=True)
    textures, texture = np.unique([world.texture for world in worlds], return_inverse=True)
    split_of_tissue = np.repeat(np.arange(len(SPLITS), dtype=np.uint8), counts)
    return FrameStore.create(
        out,
        optics=config.optics,
        scopes=[config.scope_of(number) for number in range(config.tissues)],
        scope=tissue.astype(np.int32),
        tissue_seed=tissue,
        split=split_of_tissue[tissue],
        tool_in_view=np.array([config.frame_rng(index).random() < config.tool_share for index in range(len(tissue))]),
        config=config.recipe,
        families=families.tolist(),
        family=family[tissue].astype(np.int32),
        textures=textures.tolist(),
        texture=texture[tissue].astype(np.int32),
    )


def _render_tissue(config: TrainingFramesConfig, out: Path, tissue: int) -> int:
    """Render the missing frames of one tissue and return their number."""
    store = FrameStore.open(out, writable=True)
    first = tissue * config.frames_per_tissue
    done = store.done()
    todo = [index for index in range(first, first + config.frames_per_tissue) if not done[index]]
    world = config.world_of(tissue)
    if world.family == TISSUE_FAMILY:
        _render_height_field(config, store, tissue, todo)
    else:
        render_anatomy(config, store, tissue, world, todo)
    return len(todo)


def _render_height_field(config: TrainingFramesConfig, store: FrameStore, tissue: int, frames: Sequence[int]) -> None:
    """Render some frames of a tissue that MuJoCo carries."""
    tissue_rng = config.tissue_rng(tissue)
    scene = TrainingScene(TissueConfig(), tissue_rng)
    camera = StripeCamera(Rig.from_optics(config.scope_of(tissue)), threads=1)
    camera.attach(scene.model, tissue=scene.tissue, rng=tissue_rng, appearance=config.appearance_of(tissue))
    for index in frames:
        rng = config.frame_rng(index)
        with_tool = rng.random() < config.tool_share
        scene.reset()
        pose = draw_camera(config.ranges, scene.mean_height_m, rng)
        if with_tool:
            _place_tool(config, scene, camera, pose, rng)
        optics = draw_optics(config.ranges, pose.working_distance_m, rng)
        if config.varied_light > 0.0 and rng.random() < config.varied_light:
            surface = replace(optics.tissue, subsurface=draw_subsurface(config.ranges.subsurface_fwhm_m, rng))
            optics = replace(optics, tissue=surface, response=draw_response(rng))
        camera.set_optics(optics)
        write_frame(config, store, index, camera, scene.data, pose, rng)


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
