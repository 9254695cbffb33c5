import pytest

from laploop.control.controllers.look import LookController
from laploop.control.controllers.palpate import PalpateController
from laploop.control.controllers.reach import ReachController
from laploop.control.controllers.registry import make_controller
from laploop.control.controllers.scan import ScanController
from laploop.control.controllers.track import TrackController
from laploop.errors import UnknownNameError


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


def test_unknown_task_is_named_beside_what_there_is(rig):
    with pytest.raises(UnknownNameError, match=r"juggle.*look, palpate, reach, scan, track"):
        make_controller("juggle", rig)


def test_prediction_is_the_controllers_own_unless_it_is_given(rig):
    given = make_controller("track", rig, "none")
    assert given._targeting._config.prediction == "none"
    assert make_controller("track", rig)._targeting._config.prediction == "rhythms"
    with pytest.raises(UnknownNameError, match="unknown prediction 'magic'; available: none, rate, rhythms"):
        make_controller("track", rig, "magic")
