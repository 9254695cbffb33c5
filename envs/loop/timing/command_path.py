"""The way of commands from the controllers to the arms."""

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

from laploop.arrays import Array
from laploop.envs.loop.timing.config import TimingSamples
from laploop.envs.loop.timing.latency import measured_ns
from laploop.envs.loop.timing.log import CommandTimes, TimingLog
from laploop.envs.theatre.clock_rates import ClockRates

if TYPE_CHECKING:
    from laploop.envs.loop.miscalibrated_arm import MiscalibratedArm


class JointTarget(NamedTuple):
    """Joint angles, (6,) rad, and velocities, (6,) rad/s, for an arm."""

    arm: "MiscalibratedArm"
    q: Array
    qdot: Array


@dataclass(frozen=True, kw_only=True)
class _Sent:
    targets: Sequence[JointTarget]
    times: CommandTimes


class CommandPath:
    """Delays commands by computing and transport, up to the next whole physics step.

    A command that arrives after a later tick's is dropped: arms never go back to an older one.
    """

    def __init__(self, samples: TimingSamples, rates: ClockRates, log: TimingLog) -> None:
        """Carry the commands of one episode."""
        self._samples = samples
        self._rates = rates
        self._log = log
        self._under_way: list[tuple[int, int, _Sent]] = []
        self._newest_tick_ns = -1

    def send(self, tick_ns: int, targets: Sequence[JointTarget], measured_s: float) -> None:
        """Send a control tick's targets.

        Args:
            tick_ns: Simulated time of the tick.
            targets: For all arms that are controlled.
            measured_s: Wall-clock time of the computation, which counts where computing is measured.
        """
        compute = self._samples.compute
        compute_ns = measured_ns(measured_s) if compute is None else next(compute)
        computed_ns = tick_ns + compute_ns
        arrived_ns = computed_ns + next(self._samples.transport)
        effective_ns = self._rates.physics_steps(arrived_ns) * self._rates.physics_ns
        times = CommandTimes(tick_ns=tick_ns, computed_ns=computed_ns, arrived_ns=arrived_ns, effective_ns=effective_ns)
        self._log.compute_ns.append(compute_ns)
        self._log.commands.append(times)
        heappush(self._under_way, (arrived_ns, tick_ns, _Sent(targets=targets, times=times)))

    def deliver(self, now_ns: int) -> None:
        """Give the arms what takes effect in the physics step that begins now."""
        while self._under_way and self._under_way[0][-1].times.effective_ns <= now_ns:
            sent = heappop(self._under_way)[-1]
            if sent.times.tick_ns < self._newest_tick_ns:
                sent.times.overtaken = True
                self._log.overtaken_commands += 1
                continue
            self._newest_tick_ns = sent.times.tick_ns
            for target in sent.targets:
                target.arm.command(target.q, target.qdot)
