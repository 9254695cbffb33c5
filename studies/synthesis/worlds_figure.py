"""A picture of the families of anatomy: stripes and depth of some scenes of each."""

import sys
from itertools import cycle
from pathlib import Path

import numpy as np

from laploop.assets.anatomy.families.registry import FAMILIES
from laploop.assets.anatomy.textures import TEXTURES
from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.stripe_camera import StripeCamera
from laploop.perception.geometry import Rig
from laploop.studies.scenes.anatomy_optics import AnatomyRanges, auto_exposed, draw_anatomy_optics, draw_materials
from laploop.studies.scenes.anatomy_scene import AnatomyScene
from laploop.studies.scenes.anatomy_views import draw_tools, draw_view
from laploop.whole_file import whole_file

_NEAREST_MM, _FARTHEST_MM = 30.0, 180.0
_LEVEL = 0.6


def draw_worlds(path: Path, *, scenes: int = 2, seed: int = 0) -> None:
    """Draw some scenes of each family with the textures in turn, every other one with an instrument; held-out ones in red.

    Raises:
        OutputError: If the picture cannot be written.
        InvalidValueError: If scikit-image (extra `mesh`) is not installed.
    """
    from matplotlib.figure import Figure

    columns = 2 * scenes * 2
    rows = -(-len(FAMILIES) // 2)
    figure = Figure(figsize=(1.5 * columns, 1.62 * rows))
    axes = figure.subplots(rows, columns, squeeze=False)
    ranges, textures = AnatomyRanges(far_fraction=0.0), cycle(TEXTURES)
    camera = StripeCamera(Rig.from_optics(ScopeOptics()))
    for place in axes.flat:
        place.axis("off")
    for number, (name, family) in enumerate(FAMILIES.items()):
        for scene in range(scenes):
            texture = next(textures)
            rng = np.random.default_rng([seed, number, scene])
            materials = draw_materials(ranges, rng)
            world = AnatomyScene(name, texture, materials, rng)
            camera.attach_geometry(world.geometry)
            pose = draw_view(ranges, world, camera, rng)
            if scene % 2 == 1:
                world.place_tools(draw_tools(world, camera, pose, rng))
            optics = draw_anatomy_optics(ranges, materials, pose.working_distance_m, rng)
            camera.set_optics(optics)
            expected = camera.capture(None, pose.world_from_camera, None)
            camera.set_optics(auto_exposed(expected, optics, _LEVEL))
            # Without noise, which a picture of this size does not show.
            frame = camera.capture(None, pose.world_from_camera, None)
            first = (number % 2) * 2 * scenes + 2 * scene
            left, right = axes[number // 2, first : first + 2]
            left.imshow(frame.image, cmap="gray", vmin=0, vmax=255)
            left.set_title(f"{name}, {texture}", fontsize=7, color="tab:red" if family.held_out else "black", loc="left", pad=2)
            right.imshow(frame.depth_mm, cmap="viridis_r", vmin=_NEAREST_MM, vmax=_FARTHEST_MM)
    camera.close()
    figure.subplots_adjust(left=0.004, right=0.996, top=0.985, bottom=0.004, wspace=0.03, hspace=0.10)
    with whole_file(path) as partial:
        figure.savefig(partial, format="png", dpi=76)


if __name__ == "__main__":
    draw_worlds(Path(sys.argv[1]))
