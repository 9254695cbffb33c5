import numpy as np
import pytest
from matplotlib.image import imread

from laploop.errors import InvalidValueError
from laploop.perception.messages import DepthEstimate
from laploop.perception.metrics import DepthErrors, MetricsInterval
from laploop.studies.depth.config import DepthEvaluation
from laploop.studies.depth.figure import draw_comparison, draw_distance, draw_examples
from laploop.studies.depth.table import DepthExample, DepthRow, DepthTable


def metrics_of(error_mm):
    errors = DepthErrors()
    truth = np.full((4, 4), 100.0, np.float32)
    errors.add(truth + np.float32(error_mm), truth, np.ones((4, 4), bool))
    return errors.metrics()


def row_of(model, distance, error_mm):
    interval = MetricsInterval(low=metrics_of(0.8 * error_mm), high=metrics_of(1.2 * error_mm))
    return DepthRow(
        model=model,
        against="zivid",
        working_distance_mm=distance,
        frames=2,
        valid_fraction=0.9,
        every=metrics_of(error_mm),
        every_interval=interval,
        valid=metrics_of(0.5 * error_mm),
        valid_interval=interval,
        lit_fraction=0.8,
        lit=metrics_of(error_mm),
        lit_interval=interval,
    )


@pytest.fixture
def table():
    config = DepthEvaluation(against="zivid", bins_mm=(60.0, 80.0, 100.0))
    models = {"near": 1.0, "far": 3.0, "reference": 0.7, "photon floor, 1 row": 0.2}
    rows = [row_of(model, name, scale) for model, scale in models.items() for name in ("all", "60-80", "80-100")]
    truth = np.tile(np.linspace(70.0, 110.0, 32, dtype=np.float32), (32, 1))
    mask = np.ones((32, 32), bool)
    mask[:8] = False
    truth[:8] = np.nan
    estimates = {
        name: DepthEstimate(depth_mm=np.nan_to_num(truth, nan=90.0) + np.float32(error), valid=mask)
        for name, error in (("near", 1.0), ("far", 3.0))
    }
    example = DepthExample(
        index=7, against="zivid", image=np.full((32, 32), 90, np.uint8), truth_mm=truth, mask=mask, estimates=estimates
    )
    return DepthTable(
        dataset="pairs", config=config, tissues=2, frames=4, rows=tuple(rows), median_ms={}, examples=(example, example)
    )


def test_figures_are_drawn_as_pictures_with_something_in_them(table, tmp_path):
    draw_comparison(table, tmp_path / "comparison.png")
    draw_examples(table, "far", tmp_path / "examples.png")
    draw_distance(table, "zivid", tmp_path / "distance.png")
    for name in ("comparison", "examples", "distance"):
        picture = imread(tmp_path / f"{name}.png")
        assert min(picture.shape[:2]) > 300
        assert picture[..., :3].std() > 0.03


def test_what_is_not_there_is_refused(table, tmp_path):
    empty = DepthTable(dataset="d", config=table.config, tissues=1, frames=1, rows=table.rows, median_ms={})
    with pytest.raises(InvalidValueError, match="examples"):
        draw_comparison(empty, tmp_path / "x.png")
    with pytest.raises(InvalidValueError, match="near, far"):
        draw_examples(table, "guess", tmp_path / "x.png")
    with pytest.raises(InvalidValueError, match="zivid"):
        draw_distance(table, "exact", tmp_path / "x.png")
