"""What is measured under the path tracer's light."""

from typing import Annotated

from laploop.configuration import Field, Seed, configuration


@configuration
class LightConfig:
    """Which organs and networks."""

    organs: tuple[str, ...] = ("bowel-loops", "lobes", "colon", "stomach")
    """Families of anatomy."""
    models: tuple[str, ...] = ("compact", "ssle-phase")
    """Estimators."""
    points: Annotated[int, Field(ge=7, le=1000)] = 37
    """Point projectors on the aperture."""
    seed: Seed = 40
    """Decides the organs and the noise."""
