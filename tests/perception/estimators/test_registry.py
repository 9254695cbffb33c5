import subprocess
import sys

import numpy as np
import pytest

from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError
from laploop.perception.estimators import registry
from laploop.perception.estimators.base import DepthEstimator
from laploop.perception.estimators.oracle import OracleEstimator
from laploop.perception.estimators.registry import (
    ESTIMATOR_NAMES,
    estimator_names,
    make_estimator,
    register,
)


@pytest.fixture
def own_names(monkeypatch):
    monkeypatch.setattr(registry, "_FACTORIES", dict(registry._FACTORIES))


@pytest.mark.parametrize("name", ESTIMATOR_NAMES)
def test_every_shipped_estimator_can_be_made_and_fits_the_contract(rig, name):
    assert isinstance(make_estimator(name, rig), DepthEstimator)


def test_unknown_name_is_refused_and_the_known_ones_are_listed(rig):
    with pytest.raises(UnknownNameError, match=r"compact, depth-anything, dpt, .*phase"):
        make_estimator("guess", rig)


def test_users_own_estimator_is_made_by_its_name(rig, own_names):
    register("mine", lambda rig, weights: OracleEstimator(rig))
    assert "mine" in estimator_names()
    assert isinstance(make_estimator("mine", rig), OracleEstimator)


@pytest.mark.parametrize("name", ["phase", ""])
def test_taken_or_empty_name_is_refused(name, own_names):
    with pytest.raises(InvalidValueError, match="name of the estimator"):
        register(name, lambda rig, weights: OracleEstimator(rig))


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
