import json

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, MissingFileError, UnknownNameError
from laploop.perception.calibration.calibration_file import load_record
from laploop.perception.calibration.scope_rig import rig_of, save_design
from laploop.perception.estimators.registry import ESTIMATORS, make_estimator
from laploop.perception.geometry import Rig
from laploop.perception.messages import DepthEstimate
from laploop.perception.pictures.predictor import PicturePredictor

OPTICS = ScopeOptics(baseline_m=0.0047, mask=StripeMask(stripes=19, phase=0.3, duty=0.45))


@pytest.fixture
def design(tmp_path):
    path = tmp_path / "scope.json"
    save_design(path, OPTICS)
    return path


def changed(path, **sections):
    content = json.loads(path.read_text())
    for name, change in sections.items():
        content[name] = {**content.get(name, {}), **change}
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize("optics", [ScopeOptics(), OPTICS, ScopeOptics(width=128, height=96, fov_rad=1.1)])
def test_the_rig_of_a_design_comes_back_to_the_bit(tmp_path, optics):
    save_design(tmp_path / "scope.json", optics)
    found = rig_of(load_record(tmp_path / "scope.json"), tmp_path / "scope.json")
    assert found.rig == Rig.from_optics(optics)
    assert found.misfit_mm == 0.0


def test_a_picture_is_estimated_as_by_the_estimator_alone(design, render, sphere_depth):
    rig = Rig.from_optics(OPTICS)
    picture = render(rig, sphere_depth(rig)[0], rng=np.random.default_rng(0))
    found = PicturePredictor(design, "phase").predict(picture)
    expected = make_estimator("phase", rig).estimate(picture)
    np.testing.assert_array_equal(found.raw_depth_mm, expected.depth_mm)
    np.testing.assert_array_equal(found.valid, expected.valid)
    assert found.stripes.present
    assert found.note == ""
    assert found.confidence is None
    assert found.slip is None


def test_depth_of_a_distorted_lens_is_that_of_its_pinhole(design, render):
    rig = Rig.from_optics(OPTICS)
    changed_file = json.loads(design.read_text())
    changed_file["cameras"]["scope"]["distortion"]["k1"] = -0.15
    design.write_text(json.dumps(changed_file))
    rays = load_record(design).scope.undistorted_rays()
    position = (rays[..., 0] - rig.baseline_m / 0.1 + rig.mask.half_width_tan) / rig.mask.period_tan - rig.mask.phase
    picture = np.round(90.0 + 60.0 * np.cos(2.0 * np.pi * (position - 0.5 * rig.mask.duty))).astype(np.uint8)
    found = PicturePredictor(design, "phase").predict(picture)
    assert found.valid.mean() > 0.6
    assert np.abs(found.raw_depth_mm[found.valid] - 100.0).mean() < 0.15
    raw = make_estimator("phase", rig).estimate(picture)
    assert np.abs(raw.depth_mm[raw.valid] - 100.0).mean() > 0.5


def test_confidence_is_kept_where_valid_and_slip_where_there_are_stripes(design, render):
    class Confident:
        def __init__(self, rig):
            self.shape = (rig.camera.height, rig.camera.width)

        def estimate(self, image):
            valid = np.zeros(self.shape, bool)
            valid[:100] = True
            depth, confidence = np.full(self.shape, 90.0, np.float32), np.full(self.shape, 0.75, np.float32)
            return DepthEstimate(depth_mm=depth, valid=valid, confidence=confidence, slip=confidence / 3.0)

    ESTIMATORS.register("confident", Confident)
    try:
        predictor = PicturePredictor(design, "confident")
        found = predictor.predict(render(Rig.from_optics(OPTICS), np.full((256, 256), 0.1)))
        dark = predictor.predict(np.zeros((256, 256), np.uint8))
    finally:
        ESTIMATORS.unregister("confident")
    assert (found.confidence[:100] == 0.75).all()
    assert (found.confidence[100:] == 0.0).all()
    assert (found.slip == 0.25).all()
    assert (dark.slip == 1.0).all()


@pytest.mark.parametrize("model", ["oracle", "dpt", "depth-anything"])
def test_models_that_give_no_metric_depth_of_a_picture_are_refused(design, model):
    with pytest.raises(InvalidValueError, match=f"model is '{model}'; allowed: one that gives metric depth"):
        PicturePredictor(design, model)


def test_unusable_calibrations_are_refused(design, tmp_path):
    with pytest.raises(MissingFileError, match="calibration not found"):
        PicturePredictor(tmp_path / "none.json", "phase")
    with pytest.raises(UnknownNameError, match="unknown estimator"):
        PicturePredictor(design, "phse")
    drawn = changed(design, mask={"profile": [0.0, 1.0] * 19})
    with pytest.raises(InvalidValueError, match="stripes for the network compact; a drawn mask is read by phase"):
        PicturePredictor(drawn, "compact")
    assert PicturePredictor(drawn, "phase").rig.mask.is_drawn
    wrong = changed(design, mask={"profile": None, "duty": 3.0})
    with pytest.raises(InvalidValueError, match="duty"):
        PicturePredictor(wrong, "phase")
    content = json.loads(design.read_text())
    del content["projector"]
    design.write_text(json.dumps({**content, "mask": {}}))
    with pytest.raises(InvalidValueError, match="one with a section projector"):
        PicturePredictor(design, "phase")
