import subprocess
import sys

import numpy as np
import pytest

from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError
from laploop.perception.estimators import ESTIMATORS, DepthEstimator, check_estimator, make_estimator
from laploop.perception.estimators.oracle import OracleEstimator


@pytest.fixture
def mine():
    ESTIMATORS.register("mine", OracleEstimator)
    yield
    ESTIMATORS.unregister("mine")


@pytest.mark.parametrize("name", ["oracle", "phase", "compact", "ssle-phase", "ssle", "dual-unet"])
def test_every_shipped_estimator_can_be_made_and_fits_the_contract(rig, name):
    assert isinstance(make_estimator(name, rig), DepthEstimator)


def test_unknown_name_is_refused_and_the_known_ones_are_listed(rig):
    with pytest.raises(UnknownNameError, match=r"compact, dual-unet, oracle, phase, ssle"):
        make_estimator("guess", rig)


def test_baselines_are_known_but_no_loop_can_close_on_them():
    check_estimator("dpt")
    with pytest.raises(UnknownNameError):
        ESTIMATORS.check("dpt")


def test_users_own_estimator_is_made_by_its_name(rig, mine):
    assert "mine" in ESTIMATORS.names()
    assert isinstance(make_estimator("mine", rig), OracleEstimator)
    with pytest.raises(InvalidValueError, match="name of the estimator"):
        ESTIMATORS.register("mine", OracleEstimator)


def test_arguments_are_handed_over_and_others_refused(rig):
    from laploop.perception.estimators.phase import PhaseConfig

    config = PhaseConfig(saturated=200)
    assert make_estimator("phase", rig, arguments={"config": config}).config is config
    for name, arguments in (("phase", {"colour": 3}), ("compact", {"colour": 3}), ("oracle", {"rig": 3})):
        with pytest.raises(
            InvalidValueError, match=rf"names of arguments of estimator {name} is .*; allowed: those of {name}\("
        ):
            make_estimator(name, rig, arguments=arguments)
    with pytest.raises(InvalidValueError, match="max_slip"):
        make_estimator("compact", rig, arguments={"max_slip": -1.0})


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("no_such_module:Estimator", "ModuleNotFoundError"),
        ("math:tau", "it is of type float"),
        ("builtins:str", "it made a str"),
        ("laploop.perception.networks.phase_front:rig_numbers", r"estimate\(image\); it made a tuple"),
    ],
)
def test_what_makes_no_estimator_is_refused(rig, path, message):
    with pytest.raises(InvalidValueError, match=message):
        make_estimator(path, rig)


@pytest.mark.parametrize("name", ["oracle", "phase"])
def test_weights_for_an_estimator_without_any_are_refused(rig, tmp_path, name):
    with pytest.raises(InvalidValueError, match="weights"):
        make_estimator(name, rig, tmp_path / "w.safetensors")


def test_missing_weights_are_a_missing_file(rig, tmp_path):
    with pytest.raises(MissingFileError, match=r"w\.safetensors"):
        make_estimator("compact", rig, tmp_path / "w.safetensors")


def test_asking_for_phase_does_not_load_torch():
    code = (
        "import sys\n"
        "from laploop.assets.scope_optics import ScopeOptics\n"
        "from laploop.perception.estimators import make_estimator\n"
        "from laploop.perception.geometry import Rig\n"
        "make_estimator('phase', Rig.from_optics(ScopeOptics()))\n"
        "assert 'torch' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)  # noqa: S603 - our own interpreter and text


def test_oracle_returns_the_truth_it_was_shown(rig):
    oracle = OracleEstimator(rig)
    truth = np.full((256, 256), 90.0, np.float32)
    truth[:10] = np.nan
    oracle.see_truth(truth)
    truth[20:] = 0.0  # what was shown stays as it was
    estimate = oracle.estimate(np.zeros((256, 256), np.uint8))
    assert not estimate.valid[:10].any()
    assert estimate.valid[10:].all()
    assert (estimate.depth_mm[10:] == 90.0).all()
    assert np.isfinite(estimate.depth_mm).all()


def test_oracle_that_saw_nothing_says_so(rig):
    with pytest.raises(InvalidValueError, match="see_truth"):
        OracleEstimator(rig).estimate(np.zeros((256, 256), np.uint8))


def test_oracle_refuses_truth_of_another_size(rig):
    with pytest.raises(InvalidValueError, match="depth_mm"):
        OracleEstimator(rig).see_truth(np.zeros((4, 4), np.float32))
