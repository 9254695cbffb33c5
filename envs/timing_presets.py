"""Named timings of the loop, each with the source of its numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from laploop.envs.loop.config import LoopConfig
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, LognormalLatency
from laploop.errors import InvalidValueError
from laploop.registry import Registry


@dataclass(frozen=True, kw_only=True)
class TimingPreset:
    """A timing and, where they belong to it, the rates of the loop."""

    timing: TimingConfig
    source: str
    """In one line: what it is, and where its numbers are from."""
    physics_hz: float | None = None
    camera_hz: float | None = None

    def applied_to(self, loop: LoopConfig) -> LoopConfig:
        """Return the loop with this timing.

        Raises:
            InvalidValueError: If the rest of the loop does not allow for the rates.
        """
        return replace(
            loop,
            timing=self.timing,
            physics_hz=self.physics_hz or loop.physics_hz,
            camera_hz=self.camera_hz or loop.camera_hz,
        )


def timing_preset(name: str) -> TimingPreset:
    """Return the timing of that name, or the one that `module:attribute` points at.

    Raises:
        UnknownNameError: If there is none.
        InvalidValueError: If the name stands for something else.
    """
    preset: object = TIMINGS.get(name)
    if not isinstance(preset, TimingPreset):
        raise InvalidValueError("timing", name, f"the name of a TimingPreset, not of a {type(preset).__name__}")
    return preset


def _constant(latency_ms: float) -> ConstantLatency:
    return ConstantLatency(latency_ms=latency_ms)


def _late_by(latency_ms: float) -> TimingConfig:
    """Return a timing in which depth is as late as a picture was to those who were studied, and nothing else is."""
    return TimingConfig(transfer=_constant(latency_ms), service=_constant(0.0))


def _family(name: str, source: str, latencies_ms: Mapping[int, str]) -> dict[str, TimingPreset]:
    return {
        f"{name}-{latency_ms}": TimingPreset(timing=_late_by(latency_ms), source=f"{what}; {source}")
        for latency_ms, what in latencies_ms.items()
    }


TIMINGS: Registry[TimingPreset] = Registry(
    "timing",
    "laploop.timings",
    {
        "paper": TimingPreset(
            # A camera period of 38.4 ms is 24 physics steps of 1.6 ms, and a control period of 8 ms is five.
            timing=TimingConfig(service=_constant(38.4)),
            physics_hz=625.0,
            camera_hz=1000.0 / 38.4,
            source="26.0 Hz, 38.4 ms a frame on an A100, of the network alone; the paper's own figures",
        ),
        "masknet": TimingPreset(
            timing=TimingConfig(service=LognormalLatency(median_ms=12.75, sigma=0.2)),
            source="12.75 ms a frame, of a dual network on single-shot fringes (Zuo 2025); its jitter is our assumption",
        ),
        **_family(
            "da-vinci-s",
            "photon to photon (Kibsgaard and Kraus 2017)",
            {62: "its own display", 147: "through the memory of a CPU", 256: "through that of a GPU"},
        ),
        "umi-ur5": TimingPreset(
            timing=TimingConfig(transfer=_constant(125.0), transport=_constant(100.0)),
            source="camera 125 ms, action 100 ms, perception as by default; defaults of umi/real_world/umi_env.py",
        ),
        **_family(
            "xu-2014",
            "surgeons under delay, 0 to 1000 ms in steps of 100 (Xu 2014)",
            {latency_ms: f"{latency_ms} ms" for latency_ms in range(0, 1001, 100)},
        ),
        **_family(
            "nankaku-2022",
            "surgeons under delay (Nankaku, PLoS One 2022, 0274328)",
            {latency_ms: f"{latency_ms} ms" for latency_ms in (0, 70, 100, 150, 200, 300)},
        ),
        "radixact": TimingPreset(
            timing=_late_by(630.0),
            source="630 ms from imaging to beam, of radiotherapy that follows breathing (PMC12956478)",
        ),
        "measured-compact": "laploop.envs.measured_timings:COMPACT",
        "measured-ssle-phase": "laploop.envs.measured_timings:SSLE_PHASE",
        "measured-ssle": "laploop.envs.measured_timings:SSLE",
        "measured-dual-unet": "laploop.envs.measured_timings:DUAL_UNET",
    },
)
"""In the order in which they are listed to users."""
