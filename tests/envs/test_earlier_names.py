import pytest

from laploop.envs.earlier_names import present_option, with_present_names
from laploop.errors import InvalidValueError


@pytest.mark.parametrize(
    ("earlier", "present"),
    [
        ("--loop.latency.kind", "--loop.timing.service.kind"),
        ("--loop.latency", "--loop.timing.service"),
        ("--loop.transfer-ms", "--loop.timing.transfer.latency-ms"),
        ("--loop.latency-of-something-else", "--loop.latency-of-something-else"),
        ("--loop.camera-hz", "--loop.camera-hz"),
    ],
)
def test_an_option_has_its_present_name(earlier, present):
    assert present_option(earlier) == present


def test_what_a_file_holds_under_earlier_names_is_moved():
    loop = {
        "camera_hz": 50.0,
        "latency": {"kind": "constant", "latency_ms": 5.0},
        "transfer_ms": 2.0,
        "timing": {"workers": 2},
        "proprioception": {"kinematics_delay_steps": 3, "force_delay_steps": 0, "force_noise_n": 0.1},
    }
    assert with_present_names(loop) == {
        "camera_hz": 50.0,
        "timing": {
            "workers": 2,
            "service": {"kind": "constant", "latency_ms": 5.0},
            "transfer": {"kind": "constant", "latency_ms": 2.0},
        },
        # Steps of 2 ms.
        "proprioception": {"force_noise_n": 0.1, "kinematics_delay_ms": 6.0, "force_delay_ms": 0.0},
    }
    # What was given is left as it was.
    assert loop["proprioception"]["kinematics_delay_steps"] == 3


def test_a_value_under_both_names_is_refused():
    with pytest.raises(InvalidValueError, match=r"loop\.latency is 3; allowed: none beside loop\.timing\.service"):
        with_present_names({"latency": 3, "timing": {"service": {"kind": "constant"}}})
    with pytest.raises(InvalidValueError, match=r"none beside loop\.proprioception\.force_delay_ms"):
        with_present_names({"proprioception": {"force_delay_steps": 3, "force_delay_ms": 6.0}})
