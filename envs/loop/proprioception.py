"""What the tool arm measures of itself: tip position, tip velocity and contact force, with their own delays and noise.

The channels are observables of dm_control's composer, which schedules, delays and corrupts them in physics steps.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from laploop.arrays import Array
from laploop.configuration import Field, configuration
from laploop.envs.composer_modules import composer_module
from laploop.envs.loop.timing.latency import Milliseconds
from laploop.envs.theatre.clock_rates import ClockRates
from laploop.perception.geometry import transform_points

if TYPE_CHECKING:
    from laploop.envs.loop.miscalibrated_arm import MiscalibratedTool


@configuration
class ProprioceptionConfig:
    """Delays, and noise in SI units; all off by default."""

    kinematics_delay_ms: Milliseconds = 0.0
    """Until the tip's position and velocity are known; rounded up to whole physics steps."""
    force_delay_ms: Milliseconds = 0.0
    """Until the force is known; rounded up to whole physics steps."""
    force_window_steps: Annotated[int, Field(ge=1, le=10_000)] = 4
    """The force sensor reports the mean over this many physics steps, as a strain gauge behind its low-pass filter does."""
    force_noise_n: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Standard deviation of each component in each of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ProprioceptiveReading:
    """What the channels deliver at a control tick, in the world frame and SI units."""

    tip_in_world: Array
    tip_velocity_in_world: Array
    contact_force_in_world: Array

    def seen_from(self, frame_from_world: Array) -> tuple[Array, Array, Array]:
        """Return position, velocity and force, (3,) each, in another frame, 4x4, that stands still in the world."""
        rotation = frame_from_world[:3, :3]
        position = transform_points(frame_from_world, self.tip_in_world)
        return position, rotation @ self.tip_velocity_in_world, rotation @ self.contact_force_in_world


class _Physics:
    """The part of a dm_control `Physics` that an observable uses."""

    def __init__(self, body: "MiscalibratedTool") -> None:
        self.body = body

    @contextmanager
    def suppress_physics_errors(self) -> Iterator[None]:
        yield


class Proprioception:
    """Delayed and corrupted readings of the tool arm."""

    def __init__(self, body: "MiscalibratedTool", config: ProprioceptionConfig, rates: ClockRates) -> None:
        """Set the channels up; `reset` fills them with the first reading."""
        observable = composer_module("observation.observable")
        self._made_of = body, config, rates
        self._physics = _Physics(body)
        self._force_window = config.force_window_steps
        kinematics_delay, force_delay = (
            rates.physics_steps(round(delay_ms * 1e6)) for delay_ms in (config.kinematics_delay_ms, config.force_delay_ms)
        )
        noise = partial(_add_noise, config.force_noise_n) if config.force_noise_n else None
        channels = {
            "tip": observable.Generic(lambda physics: physics.body.tip_in_world(), delay=kinematics_delay),
            "tip_velocity": observable.Generic(lambda physics: physics.body.tip_velocity_in_world(), delay=kinematics_delay),
            "force": observable.Generic(
                lambda physics: physics.body.contact_force_in_world(),
                delay=force_delay,
                buffer_size=config.force_window_steps,
                corruptor=noise,
            ),
        }
        for channel in channels.values():
            channel.enabled = True
        self._updater = composer_module("observation.updater").Updater(
            channels,
            physics_steps_per_control_step=rates.physics_steps_per_control,
            strip_singleton_buffer_dim=True,
            # Otherwise the readings before the first delayed arrival would be zeros.
            pad_with_initial_value=True,
        )

    def reset(self, random_state: np.random.RandomState) -> None:
        """Forget the past and take the first reading."""
        self._random_state = random_state
        self._updater.reset(self._physics, random_state)

    def __getstate__(self) -> dict[str, Any]:
        """Return what copies and pickles; dm_control keeps its channels as closures, which do neither."""
        channels = self._updater._enabled_structure.items()  # noqa: SLF001
        return {
            "made_of": self._made_of,
            "steps": self._updater._step_counter,  # noqa: SLF001
            "channels": {name: (channel.buffer, channel.update_schedule) for name, channel in channels},
            "noise": self._random_state.get_state(),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        Proprioception.__init__(self, *state["made_of"])
        self.reset(np.random.RandomState())
        self._updater._step_counter = state["steps"]  # noqa: SLF001
        for name, (buffer, schedule) in state["channels"].items():
            channel = self._updater._enabled_structure[name]  # noqa: SLF001
            channel.buffer, channel.update_schedule = buffer, schedule
        # The first reading has drawn noise.
        self._random_state.set_state(state["noise"])

    def before_control_period(self) -> None:
        """Plan which of the coming physics steps need a reading."""
        self._updater.prepare_for_next_control_step()

    def after_physics_step(self) -> None:
        """Take the readings that are due."""
        self._updater.update()

    def read(self) -> ProprioceptiveReading:
        """Return what has arrived by now."""
        values = self._updater.get_observation()
        force = values["force"].reshape(self._force_window, 3).mean(axis=0)
        return ProprioceptiveReading(
            tip_in_world=values["tip"], tip_velocity_in_world=values["tip_velocity"], contact_force_in_world=force
        )


def _add_noise(sigma_n: float, force: Array, random_state: np.random.RandomState) -> Any:
    return force + random_state.normal(scale=sigma_n, size=force.shape)
