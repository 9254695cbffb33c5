import json
import math

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError, OutputError, UnknownNameError
from laploop.perception.frame_store import FrameStore
from laploop.perception.geometry import Rig
from laploop.studies.depth_evaluation import DepthEvaluation, evaluate_depth


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Facing planes at 70, 90 and 150 mm, with cosine stripes where triangulation says."""
    path = tmp_path_factory.mktemp("data") / "frames"
    optics = ScopeOptics()
    rig = Rig.from_optics(optics)
    store = FrameStore.create(
        path,
        optics=optics,
        tissue_seed=np.arange(3),
        split=np.full(3, 2, np.uint8),
        tool_in_view=np.zeros(3, bool),
        config={},
    )
    for index, depth_m in enumerate((0.07, 0.09, 0.15)):
        depth = np.full((256, 256), depth_m)
        periods = (rig.projector_x(depth) + rig.mask.half_width_tan) / rig.mask.period_tan
        image = np.round(100.0 + 60.0 * np.cos(2.0 * np.pi * (periods - 0.25))).astype(np.uint8)
        store.write(index, image=image, depth_mm=(1e3 * depth).astype(np.float32), lit=np.ones((256, 256), bool))
    return path


def test_oracle_is_exact_on_every_pixel(dataset):
    row = evaluate_depth(dataset, ["oracle"], progress=False).row("oracle")
    assert (row.valid.mae_mm, row.every.mae_mm, row.valid_share) == (0.0, 0.0, 1.0)


def test_phase_is_within_a_fifth_of_a_millimetre_on_cosine_stripes(dataset):
    row = evaluate_depth(dataset, ["phase"], progress=False).row("phase")
    assert row.valid.mae_mm < 0.2  # mm; a pure cosine leaves rounding to 8 bits and the ends of the rows
    assert 0.8 < row.valid_share < 1.0
    assert row.every.mae_mm > row.valid.mae_mm


def test_frames_are_binned_by_their_median_depth_and_far_pixels_do_not_count(dataset):
    table = evaluate_depth(dataset, ["oracle"], progress=False)
    assert table.row("oracle").frames == 3
    assert table.row("oracle").every.pixels == 2 * 256 * 256
    assert table.row("oracle", "60-80").frames == 1
    assert table.row("oracle", "80-100").every.pixels == 256 * 256
    assert table.row("oracle", "120-140").frames == 0
    assert math.isnan(table.row("oracle", "120-140").valid.mae_mm)


def test_table_is_written_as_json_csv_and_markdown(dataset, tmp_path):
    evaluate_depth(dataset, ["oracle", "phase"], tmp_path / "out", progress=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["depth.csv", "depth.json", "depth.md"]
    plain = json.loads((tmp_path / "out" / "depth.json").read_text())
    assert plain["frames"] == 3
    assert "NaN" not in (tmp_path / "out" / "depth.json").read_text()
    assert {row["estimator"] for row in plain["rows"]} == {"oracle", "phase"}
    assert len((tmp_path / "out" / "depth.csv").read_text().splitlines()) == 11
    assert "| phase | all | 3 |" in (tmp_path / "out" / "depth.md").read_text()


def test_unknown_estimator_and_empty_split_are_refused(dataset):
    with pytest.raises(UnknownNameError, match="guess"):
        evaluate_depth(dataset, ["guess"], progress=False)
    with pytest.raises(InvalidValueError, match="train"):
        evaluate_depth(dataset, ["oracle"], config=DepthEvaluation(split="train"), progress=False)
    with pytest.raises(InvalidValueError, match="one name or more"):
        evaluate_depth(dataset, [], progress=False)


def test_folder_that_cannot_be_written_is_an_output_error(dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        evaluate_depth(dataset, ["oracle"], tmp_path / "file" / "out", progress=False)


@pytest.mark.parametrize("change", [{"split": "x"}, {"nearest_mm": 150.0}, {"bins_mm": (60.0,)}, {"bins_mm": (80.0, 60.0)}])
def test_impossible_configuration_is_refused(change):
    with pytest.raises(InvalidValueError):
        DepthEvaluation(**change)
