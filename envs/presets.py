"""Everything that has a name in an episode's options, in one list, each with its source."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from laploop.envs.timing_presets import TIMINGS, timing_preset

_OURS = "no measurement: for comparison"
_SCATTERING = "Jacques (Phys Med Biol 2013;58:R37), table 1"

SOURCES: Mapping[str, Mapping[str, str]] = {
    "optics": {
        "ideal": f"little but geometry shapes the image; {_OURS}",
        "paper": "the laparoscope that the simulator follows, with the contrast measured on it",
        "worst": "the pessimistic ends of what is known of light, sensor and tissue",
    },
    "tissue-class": {
        "bowel": f"mu_s' of bowel, albedo 0.4 as of serosa; {_SCATTERING}",
        "stomach": f"mu_s' of the stomach's wall, albedo 0.4 as of serosa; {_SCATTERING}",
        "liver": f"mu_s' of liver, albedo 0.1; {_SCATTERING}",
        "fat": f"mu_s' of adipose tissue, albedo 0.6; {_SCATTERING}",
    },
    "fidelity": {
        "full": "physics steps of 2 ms; the reference",
        "fast": "steps of 4 ms, coarser contacts; measured by `laploop fidelity`",
    },
    "actuation": {
        "ideal": f"servos follow at once; {_OURS}",
        "ur5-cb": "125 Hz, 35 ms: measured with MoveIt Servo (Universal_Robots_ROS2_Driver, issue 1311)",
        "ur5-e": "500 Hz, 34 ms: measured with servoj (Universal_Robots_Client_Library, issue 86)",
    },
    "trocar": {
        "none": f"a point in space without force; {_OURS}",
        "lubricated": "abdominal wall in vivo (Surg Endosc 2006;20:987), seal with silicone oil (Proc IMechE H 2015;229:271)",
        "dry": "the same wall, the greatest friction of a seal (Proc IMechE H 2015;229:271)",
    },
    "motion": {
        "still": f"nothing moves; {_OURS}",
        "breathing": "10 mm at 0.25 Hz: within the 5-12 mm at 0.2-0.35 Hz of ventilated patients",
        "beating": "1 mm at 1.2 Hz: the most of bowel, which beats at 1-1.5 Hz",
        "both": "breathing and beating together",
    },
}
"""By option and name; those of timings stand with them."""


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A name that an option takes."""

    option: str
    name: str
    source: str


def presets() -> Iterator[Preset]:
    """Yield all presets, timings first."""
    for name in TIMINGS.names():
        yield Preset(option="timing", name=name, source=timing_preset(name).source)
    for option, sources in SOURCES.items():
        for name, source in sources.items():
            yield Preset(option=option, name=name, source=source)
