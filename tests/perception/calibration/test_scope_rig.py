import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.perception.calibration.calibration_file import load_calibration, load_record
from laploop.perception.calibration.scope_rig import optics_of, rig_of, save_design
from laploop.perception.geometry import Rig

PAGE = Path(__file__).parents[3] / "docs" / "own_images.md"


@pytest.fixture
def example(tmp_path):
    """The calibration file of the documents, with all its views."""
    (text,) = re.findall(r"```json\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    content = json.loads(text)
    scope = content["cameras"]["scope"]
    scope["camera_from_board"] = scope["camera_from_board"][:1] * 5
    content["cameras"]["reference"] = scope
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(content))
    return path


def test_the_example_of_the_documents_is_the_nominal_scope(example):
    found, nominal = rig_of(load_record(example), example), Rig.from_optics(ScopeOptics())
    assert found.rig.baseline_m == pytest.approx(nominal.baseline_m, rel=1e-6)
    assert found.rig.mask.period_tan == pytest.approx(nominal.mask.period_tan, rel=1e-3)
    assert found.rig.mask.phase == pytest.approx(0.0, abs=0.01)
    assert found.rig.mask.stripes == 20
    assert load_calibration(example).scope_from_reference[2, 3] == -0.4


def test_a_design_is_read_back_without_a_reference_camera(tmp_path):
    optics = ScopeOptics(width=128, height=96, mask=StripeMask(stripes=12, phase=0.4, edge_wander=0.01))
    path = tmp_path / "scope.json"
    save_design(path, optics)
    record = load_record(path)
    assert record.stereo is None
    assert record.mask == optics.mask
    assert rig_of(record, path).rig == Rig.from_optics(optics)
    assert optics_of(record, path).fov_rad == pytest.approx(optics.fov_rad, rel=1e-12)
    with pytest.raises(ValueError, match=r"cameras\.reference"):
        load_calibration(path)


@pytest.mark.parametrize("centre_m", [[0.0, 0.0, 0.0], [-0.005, 0.0, 0.0], [0.0, 0.005, 0.0], [0.0, -0.005, 0.0]])
@pytest.mark.parametrize("roll_deg", [0, 90, 180])
def test_a_projector_that_is_not_to_the_right_is_refused(tmp_path, centre_m, roll_deg):
    with pytest.raises(ValueError, match="a projector to the camera's right"):
        _rig_with_projector(tmp_path / "scope.json", centre_m, roll_deg)


@pytest.mark.parametrize("roll_deg", [90, 180])
def test_a_projector_whose_axes_are_swapped_is_refused(tmp_path, roll_deg):
    with pytest.raises(ValueError, match="a projector to the camera's right"):
        _rig_with_projector(tmp_path / "scope.json", [0.005, 0.0, 0.0], roll_deg)


def _rig_with_projector(path, centre_m, roll_deg):
    save_design(path, ScopeOptics())
    content = json.loads(path.read_text())
    projector_from_camera = np.eye(4)
    projector_from_camera[:3, :3] = np.round(Rotation.from_euler("z", roll_deg, degrees=True).as_matrix())
    projector_from_camera[:3, 3] = -projector_from_camera[:3, :3] @ centre_m
    content["projector"]["projector_from_camera"] = projector_from_camera.tolist()
    path.write_text(json.dumps(content))
    return rig_of(load_record(path), path)
