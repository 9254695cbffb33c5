"""The rates of the loop, and their periods in integer nanoseconds of simulated time."""

from functools import cached_property
from typing import Annotated

from laploop.configuration import Field, configuration
from laploop.errors import InvalidValueError

_EXACT_NS = 1e-3
"""A period this close to a whole nanosecond is one: what is left is the rounding of a frequency such as 1000/34 Hz."""


@configuration
class ClockRates:
    """Rates of physics, control and camera: each period a whole number of physics steps, checked and never rounded.

    125 Hz is the control rate of a UR5 of the CB series; 25 Hz that of a video camera, 31.25 Hz also fits.
    """

    physics_hz: Annotated[float, Field(ge=200.0, le=5000.0)] = 500.0
    """Physics steps a second; a period of whole nanoseconds."""
    control_hz: Annotated[float, Field(ge=1.0, le=5000.0)] = 125.0
    """Control ticks a second; a period of whole physics steps."""
    camera_hz: Annotated[float, Field(ge=0.5, le=1000.0)] = 25.0
    """Frames a second; a period of whole physics steps."""

    def __post_init__(self) -> None:
        if abs(1e9 / self.physics_hz - self.physics_ns) > _EXACT_NS:
            raise InvalidValueError("physics_hz", self.physics_hz, "a rate whose period is a whole number of nanoseconds")
        for name, hertz, period_ns in (
            ("control_hz", self.control_hz, self.control_ns),
            ("camera_hz", self.camera_hz, self.camera_ns),
        ):
            if abs(1e9 / hertz - period_ns) > _EXACT_NS or period_ns % self.physics_ns:
                steps = max(1, int(self.physics_hz / hertz))
                nearest = " or ".join(f"{1e9 / (count * self.physics_ns):.5g}" for count in (steps + 1, steps))
                step = f"{self.physics_ns * 1e-6:g} ms"
                raise InvalidValueError(name, hertz, f"a period of whole physics steps of {step}; the nearest are {nearest} Hz")

    @cached_property
    def physics_ns(self) -> int:
        """The physics step in nanoseconds."""
        return round(1e9 / self.physics_hz)

    @cached_property
    def control_ns(self) -> int:
        """The control period in nanoseconds."""
        return round(1e9 / self.control_hz)

    @cached_property
    def camera_ns(self) -> int:
        """The camera period in nanoseconds."""
        return round(1e9 / self.camera_hz)

    @property
    def physics_s(self) -> float:
        """The physics step in seconds."""
        return self.physics_ns * 1e-9

    @property
    def control_s(self) -> float:
        """The control period in seconds."""
        return self.control_ns * 1e-9

    @property
    def physics_steps_per_control(self) -> int:
        """Number of physics steps in a control period."""
        return self.control_ns // self.physics_ns

    def physics_steps(self, time_ns: int) -> int:
        """Return a time as whole physics steps, rounded up."""
        return -(-time_ns // self.physics_ns)
