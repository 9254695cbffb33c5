"""How a stripe mask was made, and what that does to the edges of its stripes."""

from dataclasses import replace

from laploop.assets.stripe_mask import StripeMask
from laploop.errors import UnknownNameError

ROUTES = {
    "printed": {"edge_roughness": 0.01, "edge_wander": 0.02, "edge_correlation": 0.2},
    "chrome": {"edge_roughness": 0.002, "edge_wander": 0.0, "edge_correlation": 0.3},
}
"""Fields of `StripeMask` for the two routes that were evaluated for the laparoscope: a low-cost 3D-printed mask, now in use,
and a commercial photolithographic mask, chrome on glass.

The routes are published; figures of their edges are not, and the numbers are our choice. They assume a mask of about 10 mm
with 20 stripes, so a period of 0.5 mm, and a resin printer with pixels of 35 um, 0.07 periods: a straight edge on such a grid
is off by up to half a pixel, 0.3 pixels (0.02 periods) in standard deviation, over lengths of a few pixels, and is soft over a
seventh of one. Lithography keeps an edge to about a micrometre, 0.002 periods.

The contrasts of the preset `paper` were measured with a printed mask, and its blur compensates for ideal edges; a printed mask
on top of it costs another 0.02.
"""


def fabricated(mask: StripeMask, route: str, seed: int = 0) -> StripeMask:
    """Return the mask with the edges of a fabrication route; `seed` chooses the specimen.

    Raises:
        UnknownNameError: If there is no such route.
        InvalidValueError: If the seed is negative, or the mask is an image, whose edges are where the image has them.
    """
    if route not in ROUTES:
        raise UnknownNameError("fabrication route", route, ROUTES)
    return replace(mask, edge_seed=seed, **ROUTES[route])  # type: ignore[arg-type]
