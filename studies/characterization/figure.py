"""The stripes' visibility on one page: images with their regions, profiles with their spread, contrast against distance."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from laploop.studies.characterization.config import FIGURE_DISTANCES_MM
from laploop.studies.characterization.run import Characterization, StripeProfile
from laploop.studies.figure_style import BLUE, GREY, RED, draw_grid, figure_page, hide_frame


def draw_characterization(found: Characterization, title: str, path: Path | str) -> None:
    """Draw a characterisation as a PNG.

    The upper rows show 70 and 100 mm: the middle of the image, each with its own white, and the profile along the target's
    scale, shaded by twice the standard deviation over the region's width. Below are the target without stripes, and contrast
    and mean intensity against distance.
    """
    with figure_page(path, title=title, width_in=10.0, height_in=9.6) as figure:
        axes = figure.subplots(3, 2, width_ratios=[1.0, 1.9])
        for row, distance in enumerate(FIGURE_DISTANCES_MM):
            profile = found.at(distance)
            _draw_image(axes[row, 0], profile)
            _draw_profile(axes[row, 1], profile)
        axes[1, 1].set_xlabel("scale of the target [mm]  (towards the right: away from the scope)")
        axes[2, 0].imshow(found.reference, cmap="gray")
        _show_middle(axes[2, 0], found.reference.shape)
        axes[2, 0].set_title(f"target at {FIGURE_DISTANCES_MM[-1]} mm, without stripes")
        _draw_distances(axes[2, 1], found)


def _draw_image(axis: Axes, profile: StripeProfile) -> None:
    roi = profile.roi
    white = max(float(profile.mean.max()), 1.0)
    axis.imshow(profile.image, cmap="gray", vmin=0.0, vmax=white)
    corner, size = (roi.left - 0.5, roi.top - 0.5), (roi.right - roi.left, roi.bottom - roi.top)
    axis.add_patch(Rectangle(corner, *size, fill=False, edgecolor=BLUE, linewidth=1.6))
    axis.set(title=f"{profile.distance_mm} mm", xlabel=f"white: grey value {white:.0f} of 255")
    _show_middle(axis, profile.image.shape)


def _draw_profile(axis: Axes, profile: StripeProfile) -> None:
    low, high = profile.mean - 2.0 * profile.spread, profile.mean + 2.0 * profile.spread
    axis.fill_between(profile.scale_mm, low, high, color=BLUE, alpha=0.3, linewidth=0.0)
    axis.plot(profile.scale_mm, profile.mean, color=BLUE, linewidth=1.4)
    for places, marker in ((profile.peaks, "^"), (profile.valleys, "v")):
        axis.plot(profile.scale_mm[places], profile.mean[places], marker, color=RED, markersize=4.5)
    title = f"{profile.distance_mm} mm: Michelson contrast {profile.contrast:.2f}"
    axis.set(title=title, ylabel="mean grey value\n(shaded: 2 standard deviations)")
    axis.set_ylim(bottom=0.0)
    draw_grid(axis)
    axis.margins(x=0.01)


def _draw_distances(axis: Axes, found: Characterization) -> None:
    distances = [profile.distance_mm for profile in found.profiles]
    axis.plot(distances, [profile.contrast for profile in found.profiles], "o-", color=BLUE, linewidth=1.4, markersize=4)
    axis.set_ylim(bottom=0.0)
    title = f"one exposure for all distances ({1e3 * found.exposure_s:.1f} ms)"
    axis.set(xlabel="distance to the middle mark [mm]", title=title)
    axis.set_ylabel("Michelson contrast", color=BLUE)
    draw_grid(axis)
    intensity, means = axis.twinx(), [profile.mean_intensity for profile in found.profiles]
    intensity.plot(distances, means, "s--", color=GREY, linewidth=1.1, markersize=3.5)
    intensity.set_ylim(bottom=0.0)
    intensity.set_ylabel("mean grey value", color=GREY)
    intensity.spines["right"].set_visible(True)


def _show_middle(axis: Axes, shape: tuple[int, ...]) -> None:
    """Cut an eighth of the image off each side, where there is nothing but dark, and hide the axes."""
    height, width = shape
    axis.set(xlim=(0.125 * width, 0.875 * width), ylim=(0.875 * height, 0.125 * height))
    hide_frame(axis)
