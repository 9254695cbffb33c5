"""What the bench measures, and how often."""

from pathlib import Path
from typing import Annotated, Literal, get_args

from laploop.configuration import Field, configuration
from laploop.envs.fidelity import FidelityName
from laploop.perception.estimators.registry import check_estimator

ObservationName = Literal["state", "stripes", "depth_oracle", "depth_compact"]
"""What an environment observes; behind `depth`, which estimator makes it."""


@configuration
class BenchConfig:
    """What to measure."""

    calls: Annotated[int, Field(ge=20, le=100_000)] = 250
    """Minimum number of calls of every stage; ten of the reference camera's."""
    seed: Annotated[int, Field(ge=0, lt=2**31 - 1000)] = 0
    """Seed of the first theatre; each further episode takes the next."""
    episodes: Annotated[int, Field(ge=1, le=1000)] = 3
    """Whole episodes without a recording in each fidelity, each with the next seed."""
    estimators: tuple[str, ...] = ("oracle", "phase", "compact")
    """Estimators whose time for a frame is measured."""
    perception: str = "compact"
    """Estimator of the whole episodes."""
    seconds: Annotated[float, Field(gt=0.0, le=3600.0)] = 10.0
    """Simulated time after which an unsolved episode ends."""
    fidelities: Annotated[tuple[FidelityName, ...], Field(min_length=1, max_length=2)] = get_args(FidelityName)
    """Fidelities at which steps, episodes, resets, physics, camera and memory are measured."""
    observations: Annotated[tuple[ObservationName, ...], Field(min_length=1, max_length=4)] = get_args(ObservationName)
    """Observations whose steps are measured; behind depth, the estimator."""
    vectors: Annotated[tuple[Annotated[int, Field(ge=1, le=1024)], ...], Field(min_length=0, max_length=8)] = (2, 8, 32)
    """Numbers of environments of the vectors whose steps are measured, from the least on; memory is that between both ends."""
    rounds: Annotated[int, Field(ge=1, le=1000)] = 7
    """Measurements of each of these; those of another checkout come in between."""
    steps: Annotated[int, Field(ge=1, le=10_000)] = 10
    """Steps of the environment, 40 ms of simulated time each, in such a measurement."""
    against: Path | None = None
    """Top folder of another checkout of the project, measured in turns with this one; `against.json` holds the ratios."""
    fetch: Path | None = None
    """Interpreter (bin/python) of an environment with gymnasium-robotics, whose Fetch is measured in turns with this project's
    environment; `fetch.json` holds the ratios."""

    def __post_init__(self) -> None:
        for name in (self.perception, *self.estimators):
            check_estimator(name)
