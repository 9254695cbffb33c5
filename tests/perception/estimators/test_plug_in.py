"""An estimator from a package of its own, used by entry point and by `module:Class`."""

import json
import sys

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.cli.main import main
from laploop.errors import InvalidValueError
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.estimators import ESTIMATORS, make_estimator
from laploop.perception.geometry import Rig
from laploop.studies.depth.evaluation import evaluate_depth

OPTICS = ScopeOptics(width=32, height=32, mask=StripeMask(stripes=4))
CODE = """
import numpy as np
from laploop.perception import DepthEstimate

class Flat:
    def __init__(self, rig, *, depth_mm=90.0, weights=None):
        self.depth_mm = float(weights.read_text()) if weights else depth_mm

    def estimate(self, image):
        return DepthEstimate(depth_mm=np.full(image.shape, self.depth_mm, np.float32), valid=np.ones(image.shape, bool))

class Silent(Flat):
    def estimate(self, image):
        return None

class Blind:
    def __init__(self, rig):
        pass
"""
NAMES = ("flat", "plug_in_of_mine:Flat")


@pytest.fixture(autouse=True)
def package(tmp_path, monkeypatch):
    """Install a package with an estimator, as pip would."""
    folder = tmp_path / "site"
    info = folder / "plug_in_of_mine-1.dist-info"
    info.mkdir(parents=True)
    (folder / "plug_in_of_mine.py").write_text(CODE)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: plug_in_of_mine\nVersion: 1\n")
    (info / "entry_points.txt").write_text("[laploop.estimators]\nflat = plug_in_of_mine:Flat\n")
    monkeypatch.syspath_prepend(folder)
    yield
    sys.modules.pop("plug_in_of_mine", None)


@pytest.fixture
def dataset(tmp_path):
    """Two frames of a plane at 92 mm."""
    frames = np.zeros(2)
    store = FrameStore.create(
        tmp_path / "frames",
        optics=OPTICS,
        tissue_seed=np.arange(2),
        split=np.full(2, 2, np.uint8),
        tool_in_view=frames.astype(bool),
        config={},
    )
    for index in range(2):
        depth_mm = np.full((32, 32), 92.0, np.float32)
        store.write(index, image=np.full((32, 32), 80, np.uint8), depth_mm=depth_mm, lit=np.ones((32, 32), bool))
    return tmp_path / "frames"


@pytest.mark.parametrize("name", NAMES)
def test_it_is_made_with_its_arguments_and_weights(name, tmp_path):
    rig = Rig.from_optics(OPTICS)
    assert "flat" in ESTIMATORS.names()
    image = np.zeros((32, 32), np.uint8)
    assert (make_estimator(name, rig).estimate(image).depth_mm == 90.0).all()
    assert (make_estimator(name, rig, arguments={"depth_mm": 80.0}).estimate(image).depth_mm == 80.0).all()
    (tmp_path / "weights").write_text("70")
    assert (make_estimator(name, rig, tmp_path / "weights").estimate(image).depth_mm == 70.0).all()
    with pytest.raises(InvalidValueError, match="depth_m'"):
        make_estimator(name, rig, arguments={"depth_m": 0.08})


def test_what_is_no_estimator_is_refused():
    with pytest.raises(InvalidValueError, match=r"estimate\(image\); it made a Blind"):
        make_estimator("plug_in_of_mine:Blind", Rig.from_optics(OPTICS))


@pytest.mark.parametrize("name", NAMES)
def test_it_is_evaluated_from_python_and_from_the_command_line(name, dataset, tmp_path):
    assert evaluate_depth(dataset, [name], progress=False).row(name).every.mae_mm == pytest.approx(2.0)
    options = ["--dataset", str(dataset), "--models", name, "--resamples", "10", "--floor-rows", "--out", str(tmp_path / "out")]
    assert main(["evaluate", *options]) == 0
    rows = json.loads((tmp_path / "out" / "summary.json").read_text())["rows"]
    assert rows[0]["model"] == name
    assert rows[0]["mae_mm"] == pytest.approx(2.0)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_timed_from_the_command_line(name, dataset, tmp_path):
    options = ["--model", name, "--frames", "10", "--warm-up", "1", "--dataset", str(dataset), "--out", str(tmp_path / "out")]
    assert main(["speed", *options]) == 0
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["backend"] == "estimator"


@pytest.mark.parametrize("command", ["evaluate", "speed"])
def test_one_that_returns_nothing_is_one_clear_line(command, dataset, tmp_path, capsys):
    option = "--models" if command == "evaluate" else "--model"
    arguments = [option, "plug_in_of_mine:Silent", "--dataset", str(dataset), "--out", str(tmp_path / "out")]
    assert main([command, *arguments]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert (
        error == f"laploop {command}: estimate is 'nothing'; allowed: a DepthEstimate with depth_mm and valid of shape (32, 32)"
    )
    assert not (tmp_path / "out").exists()
