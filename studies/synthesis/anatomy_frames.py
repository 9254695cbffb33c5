"""Frames of one anatomy scene."""

from collections.abc import Sequence

from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.scenes.anatomy_optics import auto_exposed, draw_anatomy_optics, draw_materials
from laploop.studies.scenes.anatomy_scene import AnatomyScene
from laploop.studies.scenes.anatomy_views import draw_tools, draw_view
from laploop.studies.synthesis.capture import write_frame
from laploop.studies.synthesis.config import TrainingFramesConfig, World


def render_anatomy(config: TrainingFramesConfig, store: FrameStore, tissue: int, world: World, frames: Sequence[int]) -> None:
    """Render some frames of an anatomy scene into a data set."""
    ranges, scene_rng = config.anatomy_ranges, config.tissue_rng(tissue)
    materials = draw_materials(ranges, scene_rng)
    scene = AnatomyScene(world.family, world.texture, materials, scene_rng)
    camera = StripeCamera(Rig.from_optics(config.scope_of(tissue)), threads=1)
    camera.attach_geometry(scene.geometry)
    for index in frames:
        rng = config.frame_rng(index)
        with_tool = rng.random() < config.tool_share
        scene.place_tools([])
        pose = draw_view(ranges, scene, camera, rng)
        if with_tool:
            scene.place_tools(draw_tools(scene, camera, pose, rng))
        optics = draw_anatomy_optics(ranges, materials, pose.working_distance_m, rng)
        camera.set_optics(optics)
        exposed, level = rng.random(), rng.uniform(*ranges.exposure_level)
        if exposed < ranges.auto_exposure_fraction:
            expected = camera.capture(None, pose.world_from_camera, None)
            camera.set_optics(auto_exposed(expected, optics, level))
        write_frame(config, store, index, camera, None, pose, rng)
