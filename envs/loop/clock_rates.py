"""The rates of the loop, in integer nanoseconds of simulated time."""

from dataclasses import dataclass

from laploop.errors import InvalidValueError


@dataclass(frozen=True, kw_only=True)
class ClockRates:
    """Periods of physics, control and camera; each an exact multiple of the physics step, checked and never rounded.

    125 Hz is the control rate of a UR5 of the CB series; 25 Hz that of a video camera.
    """

    physics_ns: int = 2_000_000
    control_ns: int = 8_000_000
    camera_ns: int = 40_000_000

    def __post_init__(self) -> None:
        """Check the periods.

        Raises:
            InvalidValueError: If a period is not positive or not a multiple of the physics step.
        """
        if self.physics_ns <= 0:
            raise InvalidValueError("physics_ns", self.physics_ns, "above 0")
        for name in ("control_ns", "camera_ns"):
            period = getattr(self, name)
            if period <= 0 or period % self.physics_ns:
                raise InvalidValueError(name, period, f"a positive multiple of physics_ns = {self.physics_ns}")

    @property
    def physics_steps_per_control(self) -> int:
        """Number of physics steps in a control period."""
        return self.control_ns // self.physics_ns

    @property
    def control_s(self) -> float:
        """Control period in seconds."""
        return self.control_ns * 1e-9

    @property
    def physics_s(self) -> float:
        """Physics step in seconds."""
        return self.physics_ns * 1e-9
