"""Layout of a recording when it opens: a tab each for the theatre, control, perception and timing."""

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from laploop.envs.recording.picture_colors import ERROR_RANGE_MM
from laploop.envs.recording.rerun_plots import PLOTS, PREDICTION_PLOTS, REWARD_PLOT, TIMELINE
from laploop.perception.geometry import Rig

_PICTURES = {
    "stripes": "Stripes (captured)",
    "depth": "Depth (estimated)",
    "truth": "Depth (truth)",
    "error": "Error (estimate - truth)",
    "key_depth": "Key of the depth",
    "key_error": "Key of the error",
}
"""Names of the views, by entity under `scope/image/`."""


def legend(rig: Rig) -> str:
    """Write the legend as Markdown."""
    camera = rig.camera
    return f"""### Legend

- **Tissue** pink; **target** green, **goal** of the tip white, the controller's **prediction** orange; **trocars** yellow.
- **Reconstructed surface**: points coloured by their error, estimate minus truth along the viewing direction:
  red {-ERROR_RANGE_MM:+.0f} mm (too near), white 0, blue {ERROR_RANGE_MM:+.0f} mm (too far); as in the *error* image.
- **depth**, **truth**: z-depth in the camera's frame, near is dark, in the range of the key; what is nearer or farther has the
  colour of the nearer end. Grey: no value.
- Depth, truth and error belong to the frame that has just *arrived*; the stripes are the frame just *captured*.
- **Joint angles and speeds** of the moved arm over their limits, worst of the control period; 1 is at the limit.
- **States**: outcome of the inverse kinematics, what holds the arm back, faults; a lane changes where the state does.
- Camera {camera.width} x {camera.height}, f = {camera.fx:.1f} px.
- Projector {rig.baseline_m * 1e3:.1f} mm to its right, {rig.mask.stripes} stripes.
- World in metres, z up; times are simulated.
"""


def episode_blueprint(look_at: NDArray[np.float64], *, depth_maps: bool = False) -> rrb.Blueprint:
    """Lay out an episode.

    Args:
        look_at: (3,) m, middle of the tissue.
        depth_maps: Whether the recording has depth and truth as numbers, too.
    """
    return rrb.Blueprint(
        rrb.Tabs(_theatre(look_at), _control(), _perception(look_at, depth_maps=depth_maps), _timing(), active_tab=0),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _theatre(look_at: NDArray[np.float64]) -> rrb.Container:
    overview = rrb.Spatial3DView(
        name="Theatre",
        origin="world",
        contents=["+ /world/**", "- /world/surface/**"],
        eye_controls=rrb.EyeControls3D(
            position=np.add(look_at, (0.2, -1.08, 0.46)), look_target=np.add(look_at, (0.07, 0.0, 0.25))
        ),
        line_grid=False,
    )
    pictures = rrb.Horizontal(_picture("stripes"), _picture("depth"))
    plots = rrb.Vertical(_plot("target_error_mm"), _plot("force_n"))
    right = rrb.Vertical(pictures, _picture("key_depth"), plots, row_shares=[5, 1, 4])
    left = rrb.Vertical(overview, _close("Tissue", look_at, hidden="surface"), row_shares=[3, 2])
    return rrb.Horizontal(left, right, column_shares=[1, 1], name="Theatre")


def _control() -> rrb.Container:
    states = rrb.StateTimelineView(name="States of the inverse kinematics", origin="states")
    predictions = (
        rrb.TimeSeriesView(name=title, origin=f"plots/{name}", plot_legend=rrb.PlotLegend(visible=True))
        for name, title in PREDICTION_PLOTS.items()
    )
    reward = rrb.TimeSeriesView(name="Reward by term", origin=f"plots/{REWARD_PLOT}", plot_legend=rrb.PlotLegend(visible=True))
    return rrb.Horizontal(
        rrb.Vertical(_plot("tip_velocity_mmps"), _plot("off_goal_mm"), *predictions, states),
        rrb.Vertical(
            _plot("joint_position_share"), _plot("joint_speed_share"), _plot("rcm_error_mm"), _plot("port_force_n"), reward
        ),
        name="Control",
    )


def _perception(look_at: NDArray[np.float64], *, depth_maps: bool) -> rrb.Container:
    surface = _close("Reconstructed surface, coloured by its error", look_at, hidden="tissue")
    legend_view = rrb.TextDocumentView(name="Legend", origin="legend")
    numbers = (
        [rrb.Spatial2DView(name=f"{name} [mm]", origin=f"scope/depth/{name}") for name in ("estimate", "truth")]
        if depth_maps
        else []
    )
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Horizontal(_picture("stripes"), _picture("depth")),
            rrb.Horizontal(_picture("error"), _picture("truth")),
            rrb.Horizontal(_picture("key_error"), _picture("key_depth")),
            row_shares=[5, 5, 1],
        ),
        rrb.Tabs(surface, *numbers, legend_view),
        column_shares=[1, 1],
        name="Perception",
    )


def _timing() -> rrb.Container:
    return rrb.Vertical(*map(_plot, ("depth_age_ms", "frame_ms", "dropped_frames", "stage_ms")), name="Timing")


def _close(name: str, look_at: NDArray[np.float64], *, hidden: str) -> rrb.Spatial3DView:
    """Return a view of the tissue from near by, without one of the entities of the world."""
    eye = rrb.EyeControls3D(position=np.add(look_at, (0.06, -0.20, 0.10)), look_target=np.add(look_at, (0.0, 0.0, 0.012)))
    contents = ["+ /world/**", f"- /world/{hidden}/**"]
    return rrb.Spatial3DView(name=name, origin="world", contents=contents, eye_controls=eye, line_grid=False)


def _picture(entity: str) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(name=_PICTURES[entity], origin=f"scope/image/{entity}")


def _plot(name: str) -> rrb.TimeSeriesView:
    plot = PLOTS[name]
    return rrb.TimeSeriesView(
        name=plot.title,
        origin=f"plots/{name}",
        axis_y=None if plot.range is None else rrb.ScalarAxis(range=plot.range),
        plot_legend=rrb.PlotLegend(visible=len(plot.series) > 1),
    )
