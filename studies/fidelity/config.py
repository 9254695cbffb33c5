"""How much the comparison of fidelities does."""

from typing import Annotated

from laploop.configuration import Field, Seed, configuration


@configuration
class FidelityConfig:
    """How many tissues, and how hard they are pressed."""

    seeds: Annotated[int, Field(ge=1, le=1000)] = 10
    """Tissues that are pressed, and episodes of the task at each fidelity."""
    first_seed: Seed = 0
    """Seed of the first tissue; each further one has the next."""
    press_m: Annotated[float, Field(gt=0.0, le=0.01)] = 0.003
    """How far below the surface at rest the ball end's lowest point is driven."""
    perception: str = "oracle"
    """Estimator of the episodes."""
    motion: str = "breathing"
    """How the tissue moves in the episodes."""
