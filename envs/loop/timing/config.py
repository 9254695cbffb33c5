"""The timing of every stage between a scene and an arm's motion, except the arm's own, which is its actuation."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from laploop.configuration import Field, configuration
from laploop.envs.loop.timing.latency import (
    ComputationModel,
    ConstantLatency,
    LatencyModel,
    MeasuredLatency,
    Milliseconds,
)
from laploop.envs.loop.timing.latency_samples import Losses
from laploop.errors import InvalidValueError

QueueName = Literal["newest-wins", "fifo"]

Transport = Annotated[LatencyModel, Field(discriminator="kind")]
Computation = Annotated[ComputationModel, Field(discriminator="kind")]

NONE = ConstantLatency(latency_ms=0.0)
"""No time at all."""


@configuration
class TimingConfig:
    """How long each stage takes; by default perception 40 ms, and nothing else anything."""

    exposure_ms: Milliseconds = 0.0
    """Length of an exposure, at most a camera period. The frame shows the scene at its middle, and carries that time."""
    readout_ms: Milliseconds = 0.0
    """From the end of the exposure to the frame's departure from the camera."""
    time_stamp_offset_ms: Annotated[float, Field(ge=-1000.0, le=1000.0)] = 0.0
    """By how much the capture time that consumers are given is too late; it is never later than the frame's arrival. The pose
    of the camera that comes with a frame is that of the true time."""
    transfer: Transport = NONE
    """From the camera to perception; keeps nobody busy."""
    drop_rate: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Fraction of the frames that are lost on this way; the first, in which the target is chosen, never is."""
    service: Computation = ConstantLatency()
    """Of a frame by perception; keeps a worker busy."""
    pipeline: Transport = NONE
    """From perception to the consumers of depth, further stages of a pipeline included; keeps nobody busy."""
    workers: Annotated[int, Field(ge=1, le=64)] = 1
    """Frames that perception serves at the same time."""
    queue: QueueName = "newest-wins"
    """Where frames wait for a worker: one place, which a newer frame takes from an older one, or a queue in the order of
    arrival."""
    capacity: Annotated[int, Field(ge=1, le=10_000)] = 1
    """Places in a fifo queue; a frame that finds it full is dropped. With newest-wins, 1."""
    compute: Computation = NONE
    """Of a command by the controllers, from their control tick on; the arm follows its last command meanwhile."""
    transport: Transport = NONE
    """From the controllers to the arm. A command takes effect at the first physics step that begins no earlier."""

    def __post_init__(self) -> None:
        if self.queue == "newest-wins" and self.capacity != 1:
            raise InvalidValueError("capacity", self.capacity, "1 with the queue newest-wins; more with fifo")

    @property
    def exposure_ns(self) -> int:
        """Length of an exposure in nanoseconds."""
        return round(self.exposure_ms * 1e6)

    @property
    def departure_ns(self) -> int:
        """From the capture of a frame to its departure from the camera: the second half of the exposure and the readout."""
        return (self.exposure_ns + 1) // 2 + round(self.readout_ms * 1e6)

    @property
    def time_stamp_offset_ns(self) -> int:
        """By how much time stamps are too late, in nanoseconds."""
        return round(self.time_stamp_offset_ms * 1e6)

    @property
    def command_ns(self) -> int:
        """How long a command typically takes from its control tick to the arm, as a controller may know it."""
        return self.compute.typical_ns + self.transport.typical_ns


@dataclass(frozen=True, kw_only=True)
class TimingSamples:
    """The times of one episode, a sequence a stage; those that are measured are None."""

    transfer: Iterator[int]
    dropped: Iterator[bool]
    service: Iterator[int] | None
    pipeline: Iterator[int]
    compute: Iterator[int] | None
    transport: Iterator[int]

    @classmethod
    def draw(cls, config: TimingConfig, service_rng: np.random.Generator, rng: np.random.Generator) -> "TimingSamples":
        """Begin the sequences; each has a generator of its own, so that no stage depends on another's draws."""
        transfer_rng, drop_rng, pipeline_rng, compute_rng, transport_rng = rng.spawn(5)
        service, compute = config.service, config.compute
        return cls(
            transfer=config.transfer.samples_ns(transfer_rng),
            dropped=Losses(config.drop_rate, drop_rng),
            service=None if isinstance(service, MeasuredLatency) else service.samples_ns(service_rng),
            pipeline=config.pipeline.samples_ns(pipeline_rng),
            compute=None if isinstance(compute, MeasuredLatency) else compute.samples_ns(compute_rng),
            transport=config.transport.samples_ns(transport_rng),
        )
