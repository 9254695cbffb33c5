"""Controllers by name: ours, other packages', and whatever a user points at."""

import sys

import pytest

from laploop.control import make_controller, make_predictor
from laploop.control.controllers.look import LookController
from laploop.control.controllers.palpate import PalpateController
from laploop.control.controllers.reach import ReachController
from laploop.control.controllers.scan import ScanController
from laploop.control.controllers.track import TrackController
from laploop.control.prediction.alpha_beta import AlphaBetaFilter, HeldMeasurement
from laploop.control.prediction.rhythm_predictor import RhythmPredictor
from laploop.errors import InvalidValueError, UnknownNameError

PACKAGE = """
import numpy as np
from laploop.control import Prediction

class Still:
    def __init__(self, rig, *, gain=1.0, predictor=None):
        self.rig, self.gain, self.predictor = rig, gain, predictor
    def reset(self): pass
    def command(self, state): return np.zeros(3)

class Never:
    def __init__(self, *, horizon_s=0.1): self.horizon_s = horizon_s
    def reset(self): pass
    def update(self, measured, captured_ns): return False
    def predict(self, at_ns): return Prediction(value=0.0, velocity=0.0, trusted=False)

def nothing(*given, **arguments): return None
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package that adds a controller and a predictor, one entry each."""
    (tmp_path / "control_of_mine.py").write_text(PACKAGE)
    info = tmp_path / "control_of_mine-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: control_of_mine\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[laploop.controllers]\nstill = control_of_mine:Still\n[laploop.predictors]\nnever = control_of_mine:Never\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("control_of_mine", None)


@pytest.mark.parametrize(
    ("task", "cls"),
    [
        ("reach", ReachController),
        ("track", TrackController),
        ("palpate", PalpateController),
        ("scan", ScanController),
        ("look", LookController),
    ],
)
def test_every_task_has_its_controller(rig, task, cls):
    assert type(make_controller(task, rig)) is cls


def test_unknown_controller_is_named_beside_what_there_is(rig):
    with pytest.raises(UnknownNameError, match="unknown controller 'juggle'; available: image-servo, look, palpate, reach"):
        make_controller("juggle", rig)


@pytest.mark.parametrize(("name", "cls"), [("none", HeldMeasurement), ("rate", AlphaBetaFilter), ("rhythms", RhythmPredictor)])
def test_every_prediction_has_its_predictor(name, cls):
    assert type(make_predictor(name)) is cls


def test_prediction_is_the_controllers_own_unless_it_is_given(rig):
    def predictor(controller):
        return controller._targeting._motion._predictor

    assert type(predictor(make_controller("track", rig))) is RhythmPredictor
    assert type(predictor(make_controller("track", rig, prediction="none"))) is HeldMeasurement
    own = HeldMeasurement()
    assert predictor(make_controller("track", rig, prediction=own)) is own
    slow = make_controller("track", rig, prediction="rhythms", prediction_arguments={"search": {"span_s": 20.0}})
    assert predictor(slow)._config.search.span_s == 20.0
    with pytest.raises(UnknownNameError, match="unknown prediction 'magic'; available: none, rate, rhythms"):
        make_controller("track", rig, prediction="magic")


def test_an_object_that_is_no_predictor_is_refused(rig):
    with pytest.raises(InvalidValueError, match=r"predictor is 3; allowed: an object with reset, update and predict"):
        make_controller("track", rig, prediction=3)


def test_arguments_of_a_scripted_controller_are_fields_of_its_configuration(rig):
    controller = make_controller("scan", rig, arguments={"approach": {"motion": {"max_speed_mps": 0.03}}})
    assert controller._config.approach.motion.max_speed_mps == 0.03
    # What is not given stays as this controller has it.
    assert controller._config.targeting.prediction == "rhythms"
    with pytest.raises(InvalidValueError, match=r"approach\.motion\.max_speed_mps is 3\.0; allowed: above 0, at most 1"):
        make_controller("scan", rig, arguments={"approach": {"motion": {"max_speed_mps": 3.0}}})
    with pytest.raises(UnknownNameError, match=r"unknown field 'scan_sped_mps'; did you mean 'scan_speed_mps'"):
        make_controller("scan", rig, arguments={"scan_sped_mps": 0.01})


@pytest.mark.parametrize("name", ["still", "control_of_mine:Still"])
def test_a_controller_of_another_package_needs_one_entry_or_none(rig, package, name):
    controller = make_controller(name, rig, arguments={"gain": 2.0})
    assert (controller.rig, controller.gain, controller.predictor) == (rig, 2.0, None)
    assert type(make_controller(name, rig, prediction="rate").predictor) is AlphaBetaFilter


@pytest.mark.parametrize("name", ["never", "control_of_mine:Never"])
def test_a_predictor_of_another_package_needs_one_entry_or_none(rig, package, name):
    assert make_predictor(name, {"horizon_s": 0.2}).horizon_s == 0.2
    own = make_controller("track", rig, arguments={"targeting": {"prediction": name}})
    assert type(own._targeting._motion._predictor).__name__ == "Never"


def test_arguments_that_a_users_class_does_not_take_are_named(rig, package):
    with pytest.raises(InvalidValueError, match=r"arguments of controller still is \['size'\]; allowed: those of still\(rig"):
        make_controller("still", rig, arguments={"size": 1})
    with pytest.raises(InvalidValueError, match=r"names of arguments of prediction never is \['size'\]"):
        make_predictor("never", {"size": 1})


def test_what_is_no_controller_or_predictor_is_refused(rig, package):
    with pytest.raises(InvalidValueError, match="one with reset and command; it made a NoneType"):
        make_controller("control_of_mine:nothing", rig)
    with pytest.raises(InvalidValueError, match="one with reset, update and predict; it made a NoneType"):
        make_predictor("control_of_mine:nothing")
    with pytest.raises(InvalidValueError, match="a class or a function; it is of type module"):
        make_controller("control_of_mine:np", rig)
