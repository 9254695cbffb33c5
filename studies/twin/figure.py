"""The comparison with the path tracer on one page: images and their difference, contrast, the border of a shadow, lines."""

from pathlib import Path

import numpy as np

from laploop.studies.figure_style import BLUE, RED, draw_grid, figure_page, hide_frame
from laploop.studies.twin.compare import TwinComparison, line_profile
from laploop.studies.twin.scene import PLANE_DISTANCES_MM, SPOTS

_SURFACES = {"none": "card", "gaussian": "Gaussian", "dipole": "dipole"}


def draw_twin(found: TwinComparison, title: str, path: Path | str) -> None:
    """Draw a comparison as a PNG: a row a scene, then the planes' contrast, and profiles across a shadow's border and lines.

    The distance between edges is the median over all of them.
    """
    with figure_page(path, title=title, width_in=9.0, height_in=2.7 * len(found.scenes) + 2.9) as figure:
        axes = figure.subplots(len(found.scenes) + 1, 3)
        for row, compared in zip(axes, found.scenes, strict=False):
            white = float(compared.twin.max())
            difference = 100.0 * (compared.camera - compared.twin) / white
            offsets = np.abs(compared.edge_offsets_px(found.period_px))
            names = (f"{compared.scene.name}: stripe camera", "path tracer")
            for axis, image, name in zip(row, (compared.camera, compared.twin), names, strict=False):
                axis.imshow(image, cmap="gray", vmin=0.0, vmax=white)
                axis.set_title(name)
                hide_frame(axis)
            shown = row[2].imshow(difference, cmap="RdBu", vmin=-5.0, vmax=5.0)
            row[2].set_title(f"difference; edges {np.median(offsets):.2f} px apart")
            hide_frame(row[2])
            figure.colorbar(shown, ax=row[2], label="% of white", shrink=0.8)
        contrast, border, lines = axes[-1]
        for values, colour, name in zip(found.contrasts.T, (BLUE, RED), ("stripe camera", "path tracer"), strict=True):
            contrast.plot(PLANE_DISTANCES_MM, values, "o-" if colour == BLUE else "x--", color=colour, label=name)
        contrast.set(title="contrast of a facing plane", xlabel="distance [mm]", ylabel="Michelson contrast")
        contrast.legend(frameon=False)
        columns = slice(80, 110)
        for image, colour, style in ((found.shadow.camera, BLUE, "o-"), (found.shadow.twin, RED, "x--")):
            border.plot(np.arange(256)[columns], image.mean(axis=0)[columns], style, color=colour, markersize=4)
        border.set(title="across the border of a shadow", xlabel="column [px]", ylabel="electrons")
        for spread, spot in zip(SPOTS, found.spots, strict=True):
            for image, colour, style in ((spot.camera, BLUE, "-"), (spot.twin, RED, "--")):
                place_mm, light = line_profile(image)
                lines.plot(place_mm, light, style, color=colour)
            lines.annotate(_SURFACES[spread.profile], (0.45, light.max()), va="bottom")
        lines.set(title="light of a line of 0.5 mm", xlabel="across it [mm]", ylabel="share a pixel", xlim=(-4.0, 4.0))
        for axis in (contrast, border, lines):
            axis.set_ylim(bottom=0.0)
            draw_grid(axis)
