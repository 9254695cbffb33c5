"""This project's environment against Gymnasium-Robotics' Fetch, a rigid arm: CPU time of 40 ms of the world."""

from collections.abc import Mapping
from typing import Any

from laploop.studies.timing.interleaving import Spread, in_turns
from laploop.studies.timing.probe_process import ProbeProcess

OURS = (("fast", "state"), ("full", "depth_oracle"))
"""Fidelity and observation of what Fetch is compared with."""


def compare_with_fetch(
    fetch: ProbeProcess, ours: tuple[ProbeProcess, ProbeProcess], *, seed: int, steps: int, rounds: int
) -> dict[str, Any]:
    """Measure steps of Fetch and of this project's environments in turns.

    Args:
        fetch: Made by `start_fetch`.
        ours: Probes of this checkout, one for each of `OURS`.
        seed: Of the theatre.
        steps: Number of steps, of 40 ms each, in a measurement.
        rounds: Number of measurements.

    Returns:
        `fetch`: which environment, at which version, with or without its picture, and its `cpu_ms`; then fidelity >
        observation > `cpu_ms`, and `ratio` to Fetch; each a median with its quartiles.
    """
    fetch.prepare("steps", {"count": steps})
    probes = {"fetch": fetch}
    for probe, (fidelity, observation) in zip(ours, OURS, strict=True):
        probe.prepare("steps", {"fidelity": fidelity, "observation": observation, "seed": seed, "count": steps})
        probes[f"{fidelity} {observation}"] = probe
    samples = in_turns(probes, rounds)
    cpu_ms = {name: [1e3 * one["cpu_s"] / one["units"] for one in found] for name, found in samples.items()}
    result: dict[str, Any] = {"fetch": {**fetch.greeting, "cpu_ms": Spread.of(cpu_ms["fetch"]).as_dict()}}
    for fidelity, observation in OURS:
        spent = cpu_ms[f"{fidelity} {observation}"]
        ratio = Spread.of_ratio(spent, cpu_ms["fetch"])
        result[fidelity] = {observation: {"cpu_ms": Spread.of(spent).as_dict(), "ratio": ratio.as_dict()}}
    return result


def fetch_sentence(result: Mapping[str, Any]) -> str:
    """Say in Markdown what the comparison gave."""
    fetch = result["fetch"]
    picture = fetch["picture"]
    seen = f"with a picture of {picture[0]} x {picture[1]}" if picture else f"without its picture ({fetch['why_not']})"
    parts = []
    for fidelity, observation in OURS:
        ours = result[fidelity][observation]
        ratio = ours["ratio"]
        parts.append(
            f"`{fidelity}`, `{observation}` {ours['cpu_ms']['median']:.3g} ms, {ratio['median']:.2f} of it "
            f"({ratio['p25']:.2f} to {ratio['p75']:.2f})"
        )
    return (
        f"CPU time of {fetch['step_ms']:g} ms of the world: {fetch['environment']} {seen} {fetch['cpu_ms']['median']:.3g} ms; "
        f"{'; '.join(parts)}."
    )
