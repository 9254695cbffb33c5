import json
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.fidelity import FidelityName
from laploop.envs.loop.timing.config import TimingConfig
from laploop.envs.loop.timing.latency import ConstantLatency, LognormalLatency
from laploop.envs.presets import SOURCES, presets
from laploop.envs.sensors.optics.presets import PRESETS
from laploop.envs.sensors.optics.tissue_classes import TISSUE_CLASSES, TissueClassName
from laploop.envs.theatre.actuation import ActuationName
from laploop.envs.theatre.organ_motion import MotionName
from laploop.envs.theatre.trocar import TrocarName
from laploop.envs.timing_presets import TIMINGS, TimingPreset
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.perception import NETWORKS

RESULTS = Path(__file__).parents[2] / "docs/results"


def loop_of(name, **options):
    return EpisodeConfig.of(timing=name, **options).task.loop


@pytest.mark.parametrize(
    ("name", "age_ms"),
    [
        *((f"da-vinci-s-{ms}", ms) for ms in (62, 147, 256)),
        *((f"xu-2014-{ms}", ms) for ms in range(0, 1001, 100)),
        *((f"nankaku-2022-{ms}", ms) for ms in (0, 70, 100, 150, 200, 300)),
        ("radixact", 630),
    ],
)
def test_depth_is_as_late_as_pictures_were_in_a_study(name, age_ms):
    assert loop_of(name).timing == TimingConfig(
        transfer=ConstantLatency(latency_ms=float(age_ms)), service=ConstantLatency(latency_ms=0.0)
    )


def test_the_papers_rate_is_made_of_whole_physics_steps():
    loop = loop_of("paper")
    assert (loop.camera_ns, loop.physics_ns, loop.control_ns) == (38_400_000, 1_600_000, 8_000_000)
    assert 1e9 / loop.camera_ns == pytest.approx(26.0, abs=0.05)
    assert loop.timing.service == ConstantLatency(latency_ms=38.4)
    with pytest.raises(InvalidValueError, match=r"camera_hz is 26\.04.* a period of whole physics steps of 4 ms"):
        loop_of("paper", fidelity="fast")


def test_single_stages_of_a_preset_can_be_changed():
    timing = loop_of("umi-ur5", perception_latency_ms=5.0).timing
    assert [stage.latency_ms for stage in (timing.transfer, timing.service, timing.transport)] == [125.0, 5.0, 100.0]
    service = loop_of("masknet").timing.service
    assert (service, service.typical_ns) == (LognormalLatency(median_ms=12.75, sigma=0.2), 12_750_000)


@pytest.mark.parametrize("network", NETWORKS.names())
def test_a_networks_measured_timing_is_the_trace_of_its_committed_speed(network):
    summary = json.loads((RESULTS / f"speed-{network}.json").read_text())
    trace = loop_of(f"measured-{network}").timing.service
    assert len(trace.latencies_ms) == summary["config"]["speed"]["frames"]
    assert trace.typical_ns == pytest.approx(1e6 * summary["p50_ms"], abs=1)


def test_an_unknown_timing_is_refused_and_one_of_a_users_own_taken():
    with pytest.raises(UnknownNameError, match="unknown timing 'papper'; did you mean 'paper'"):
        loop_of("papper")
    TIMINGS.register("mine", TimingPreset(timing=TimingConfig(workers=2), source="test"))
    try:
        assert loop_of("mine").timing.workers == 2
    finally:
        TIMINGS.unregister("mine")
    with pytest.raises(InvalidValueError, match="the name of a TimingPreset, not of a"):
        loop_of("os:getcwd")


def test_every_name_that_an_option_takes_is_listed_with_one_line_of_source():
    names = {
        "optics": tuple(PRESETS),
        "tissue-class": get_args(TissueClassName),
        "fidelity": get_args(FidelityName),
        "actuation": get_args(ActuationName),
        "trocar": get_args(TrocarName),
        "motion": get_args(MotionName),
    }
    assert {option: tuple(sources) for option, sources in SOURCES.items()} == names
    listed = list(presets())
    assert len(listed) == 28 + sum(map(len, names.values()))
    assert all(10 < len(preset.source) < 110 and "\n" not in preset.source for preset in listed)


def test_a_tissue_class_changes_what_the_beam_meets():
    assert get_args(TissueClassName) == tuple(TISSUE_CLASSES)
    usual, liver = (EpisodeConfig.of(optics="worst", tissue_class=name).task.loop.optics for name in (None, "liver"))
    assert (liver.tissue.albedo, liver.tissue.subsurface.profile) == (pytest.approx(0.1), "dipole")
    # Gloss and all else stay those of the optics.
    assert replace(liver, tissue=replace(liver.tissue, albedo=0.3, subsurface=usual.tissue.subsurface)) == usual


def test_an_episode_of_the_papers_timing_runs_at_its_rates(task_env):
    loop = loop_of("paper")
    env = task_env("reach", timing=loop.timing, physics_hz=loop.physics_hz, camera_hz=loop.camera_hz)
    _, info = env.reset(seed=3)
    ages = [env.step(np.zeros(3, np.float32))[-1]["depth_age_ms"] for _ in range(10)]
    # The first depth is there at 38.4 ms and seen at 40; the second at 76.8 and seen at 80.
    assert (info["depth_age_ms"], ages[4]) == pytest.approx((40.0, 80.0 - 38.4))
