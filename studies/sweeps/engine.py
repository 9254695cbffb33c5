"""Where the episodes of a sweep run."""

from typing import Literal

from laploop.configuration import Workers, configuration
from laploop.errors import InvalidValueError


@configuration
class Engine:
    """Where episodes run."""

    engine: Literal["process", "ray"] = "process"
    """Worker processes of this machine, or a Ray cluster; one of this machine alone without an address."""
    workers: Workers = 1
    """Processes that run episodes at the same time; for a cluster, of one that is started here."""
    address: str | None = None
    """Of a running Ray cluster, host:port or ray://host:port."""

    def __post_init__(self) -> None:
        if self.address is not None and self.engine != "ray":
            raise InvalidValueError("address", self.address, "none without the engine ray")
