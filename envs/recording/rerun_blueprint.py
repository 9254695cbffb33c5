"""Layout of a recording when it opens: views, plots with their names and units, and the legend."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from laploop.envs.loop.timing.log import FRAME_STAGES
from laploop.envs.recording.recorder import STAGES
from laploop.perception.geometry import Rig

ERROR_RANGE_MM = 3.0
"""The colours of depth errors span this in both directions."""

Color = tuple[int, int, int]

# Okabe and Ito's palette, which colour-blind readers can tell apart.
_BLUE, _ORANGE, _GREEN, _RED, _PURPLE = (0, 114, 178), (230, 159, 0), (0, 158, 115), (213, 94, 0), (204, 121, 167)
_SKY, _GREY = (86, 180, 233), (120, 120, 120)


@dataclass(frozen=True, kw_only=True)
class Plot:
    """One plot under `plots/`."""

    title: str
    """With the unit."""
    series: Mapping[str, tuple[str, Color]]
    """Entity below the plot: its name in the legend, and its colour."""
    range: tuple[float, float] | None = None
    """Initial range of the vertical axis; None lets the viewer choose."""


PLOTS: Mapping[str, Plot] = {
    "target_error_mm": Plot(title="Target error [mm]", series={"target": ("tip to target [mm]", _BLUE)}),
    "rcm_error_mm": Plot(
        title="Trocar (RCM) error [mm]",
        series={"camera": ("camera arm [mm]", _ORANGE), "tool": ("tool arm [mm]", _BLUE)},
    ),
    "port_force_n": Plot(
        title="Force of the wall at the trocar [N]",
        series={"camera": ("on the scope's shaft [N]", _ORANGE), "tool": ("on the tool's shaft [N]", _BLUE)},
    ),
    "force_n": Plot(title="Contact force [N]", series={"force": ("tip on tissue [N]", _RED)}),
    "depth_age_ms": Plot(title="Age of the newest depth frame [ms]", series={"age": ("age [ms]", _GREEN)}),
    "frame_ms": Plot(
        title="Age of the newest used frame by stage [ms]",
        series={
            stage: (f"{stage} [ms]", color)
            for stage, color in zip(FRAME_STAGES, (_SKY, _GREY, _GREEN, _PURPLE, _ORANGE), strict=True)
        },
    ),
    "stage_ms": Plot(
        title="Wall time by stage [ms]",
        series={
            stage: (f"{stage} [ms]", color)
            for stage, color in zip(STAGES, (_BLUE, _SKY, _ORANGE, _GREEN, _GREY, _RED, _PURPLE), strict=True)
        },
    ),
}


_IN_TABS = ("rcm_error_mm", "port_force_n", "depth_age_ms", "frame_ms", "stage_ms")


def legend(rig: Rig) -> str:
    """Write the legend as Markdown."""
    camera = rig.camera
    return f"""### Legend

- **Tissue** pink; **target** green; **trocars** yellow rings.
- **Reconstructed surface**: points coloured by their error, estimate minus truth along the viewing direction:
  red {-ERROR_RANGE_MM:+.0f} mm (too near), yellow 0, blue {ERROR_RANGE_MM:+.0f} mm (too far); as in the *error* image.
- **depth**, **truth**: z-depth in the camera's frame, inferno (near is dark), the same range; black where there is none.
- Depth, truth and error belong to the frame that has just *arrived*; the stripes are the frame just *captured*.
- Camera {camera.width} x {camera.height}, f = {camera.fx:.1f} px.
- Projector {rig.baseline_m * 1e3:.1f} mm to its right, {rig.mask.stripes} stripes.
- World in metres, z up; times are simulated.
"""


def episode_blueprint(look_at: NDArray[np.float64]) -> rrb.Blueprint:
    """Lay out an episode: theatre and tissue, whose middle is `look_at`, (3,) m, on the left, images and plots on the right."""
    overview = rrb.Spatial3DView(
        name="Theatre",
        origin="world",
        contents=["+ /world/**", "- /world/surface/**"],
        eye_controls=rrb.EyeControls3D(
            position=np.add(look_at, (0.2, -1.08, 0.46)), look_target=np.add(look_at, (0.07, 0.0, 0.25))
        ),
        line_grid=False,
    )
    close_eye = rrb.EyeControls3D(position=np.add(look_at, (0.06, -0.20, 0.10)), look_target=np.add(look_at, (0.0, 0.0, 0.012)))
    tissue, surface = (
        rrb.Spatial3DView(
            name=name,
            origin="world",
            contents=["+ /world/**", f"- /world/{hidden}/**"],
            eye_controls=close_eye,
            line_grid=False,
        )
        for name, hidden in (("Tissue", "surface"), ("Reconstructed surface, coloured by its error", "tissue"))
    )
    images = rrb.Grid(
        *(
            rrb.Spatial2DView(name=name, origin=f"scope/image/{entity}")
            for entity, name in (
                ("stripes", "Stripes (captured)"),
                ("depth", "Depth (estimated)"),
                ("truth", "Depth (truth)"),
                ("error", f"Error (red {-ERROR_RANGE_MM:.0f}, blue +{ERROR_RANGE_MM:.0f} mm)"),
            )
        ),
        grid_columns=2,
    )
    plots = {
        name: rrb.TimeSeriesView(
            name=plot.title,
            origin=f"plots/{name}",
            axis_y=None if plot.range is None else rrb.ScalarAxis(range=plot.range),
            plot_legend=rrb.PlotLegend(visible=len(plot.series) > 1),
        )
        for name, plot in PLOTS.items()
    }
    legend_view = rrb.TextDocumentView(name="Legend", origin="legend")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(overview, rrb.Horizontal(tissue, surface), row_shares=[5, 4]),
            rrb.Vertical(
                images,
                plots["target_error_mm"],
                plots["force_n"],
                rrb.Tabs(*(plots[name] for name in _IN_TABS), legend_view),
                row_shares=[4, 1, 1, 1],
            ),
            column_shares=[1, 1],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )
