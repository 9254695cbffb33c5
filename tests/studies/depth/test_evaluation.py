import json
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError, LaploopError, MissingFileError, OutputError, UnknownNameError
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairFrame, PairStore
from laploop.perception.estimators import ESTIMATORS
from laploop.perception.estimators.monocular import MODELS, MonocularEstimator
from laploop.perception.estimators.phase import PhaseEstimator
from laploop.perception.geometry import Intrinsics, Rig, invert_transform, transform_points
from laploop.perception.messages import DepthEstimate
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.depth.config import DepthEvaluation
from laploop.studies.depth.evaluation import EstimatorCache, evaluate_depth

OFFSET_MM = 2.0
"""By how much the reference camera of the pairs below is wrong along the scope's axis."""


def stripes(rig, depth_m):
    periods = (rig.projector_x(depth_m) + rig.mask.half_width_tan) / rig.mask.period_tan
    return np.round(100.0 + 60.0 * np.cos(2.0 * np.pi * (periods - 0.25))).astype(np.uint8)


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
        store.write(index, image=stripes(rig, depth), depth_mm=(1e3 * depth).astype(np.float32), lit=np.ones((256, 256), bool))
    return path


def camera_of(intrinsics):
    return CameraCalibration(
        intrinsics=intrinsics,
        distortion=BrownDistortion(),
        view_errors_px=(0.1,) * 5,
        camera_from_board=np.stack([np.eye(4)] * 5),
    )


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    """Four planes of two tissues, paired with a camera at the scope's own place that reads `OFFSET_MM` too far."""
    path = tmp_path_factory.mktemp("data") / "pairs"
    optics = ScopeOptics(width=64, height=64, mask=StripeMask(stripes=10))
    rig = Rig.from_optics(optics)
    region = Intrinsics(width=160, height=160, fx=2.5 * rig.camera.fx, fy=2.5 * rig.camera.fy, cx=80.0, cy=100.0)
    calibration = StereoCalibration(
        scope=camera_of(rig.camera),
        reference=camera_of(region),
        scope_from_reference=np.eye(4),
        view_errors_px=(0.1,) * 5,
    )
    store = PairStore.create(
        path,
        optics=optics,
        reference_intrinsics=region,
        true_scope_from_reference=np.eye(4),
        calibration=calibration,
        tissue_seed=np.array([4, 4, 9, 9]),
        split=np.full(4, 2, np.uint8),
        tool_in_view=np.zeros(4, bool),
        config={},
    )
    for index, depth_m in enumerate((0.08, 0.09, 0.10, 0.11)):
        depth = np.full((64, 64), depth_m)
        z_mm = np.full((160, 160), 1e3 * depth_m + OFFSET_MM, np.float32)
        blank = np.zeros((64, 64), np.float32)
        frame = PairFrame(
            image=stripes(rig, depth),
            reference_depth_mm=blank,
            depth_mm=(1e3 * depth).astype(np.float32),
            lit=np.ones((64, 64), bool),
            shadow=np.zeros((64, 64), bool),
            projector_x=blank,
            projector_y=blank,
            reference_z_mm=z_mm,
            reference_rgba=np.zeros((160, 160, 4), np.uint8),
        )
        store.write(index, frame, {})
        reprojected = store.reproject_with(index, np.eye(4)).depth_mm
        store.write(index, PairFrame(**{**vars(frame), "reference_depth_mm": reprojected}), {})
    return path


@pytest.fixture
def register():
    """Return a function that registers an estimator for one test."""
    names = []

    def add(name, factory):
        ESTIMATORS.register(name, factory)
        names.append(name)

    yield add
    for name in names:
        ESTIMATORS.unregister(name)


def test_oracle_is_exact_on_every_pixel(dataset):
    row = evaluate_depth(dataset, ["oracle"], progress=False).row("oracle")
    assert (row.valid.mae_mm, row.every.mae_mm, row.valid_fraction) == (0.0, 0.0, 1.0)


def test_phase_is_within_a_fifth_of_a_millimetre_on_cosine_stripes(dataset):
    row = evaluate_depth(dataset, ["phase"], progress=False).row("phase")
    assert row.valid.mae_mm < 0.2  # mm; a pure cosine leaves rounding to 8 bits and the ends of the rows
    assert 0.8 < row.valid_fraction < 1.0
    assert row.every.mae_mm > row.valid.mae_mm


def test_all_models_are_measured_where_phase_is_valid(dataset, register):
    class Late:
        """Sees everything 3 mm too far, and marks nothing valid."""

        def __init__(self, rig):
            self.inner = PhaseEstimator(rig=rig)

        def estimate(self, image):
            found = self.inner.estimate(image)
            return DepthEstimate(depth_mm=found.depth_mm + np.float32(3.0), valid=np.zeros_like(found.valid))

    register("late", Late)
    table = evaluate_depth(dataset, ["late", "phase", "oracle"], progress=False)
    for distance in ("all", "60-80", "80-100"):
        late, phase, oracle = (table.row(name, distance) for name in ("late", "phase", "oracle"))
        assert phase.phase_valid_mae_mm.value == pytest.approx(phase.valid.mae_mm)
        assert phase.phase_valid_share.value == pytest.approx(phase.valid_fraction)
        assert late.phase_valid_share == oracle.phase_valid_share == phase.phase_valid_share
        assert late.phase_valid_mae_mm.value == pytest.approx(3.0 + phase.valid.bias_mm, abs=1e-4)  # mm; no error beyond 3 mm
        assert oracle.phase_valid_mae_mm.value == 0.0
        assert late.lit_valid_share.value == 0.0
    assert phase.lit_valid_share.value == pytest.approx(phase.valid_fraction)  # all is lit
    low, high = table.row("late").phase_valid_mae_mm.low, table.row("late").phase_valid_mae_mm.high
    assert low <= table.row("late").phase_valid_mae_mm.value <= high
    line = table.row("photon floor, 1 row").flat()
    assert [line[name] for name in ("lit_valid_share", "phase_valid_share", "phase_valid_mae_mm")] == [None] * 3


def test_where_phase_is_valid_nobody_knows_without_it(dataset):
    line = evaluate_depth(dataset, ["oracle"], progress=False).row("oracle").flat()
    assert [line[name] for name in ("phase_valid_share", "phase_valid_mae_mm", "phase_valid_mae_mm_low")] == [None] * 3


def test_frames_are_binned_by_their_median_depth_and_far_pixels_do_not_count(dataset):
    table = evaluate_depth(dataset, ["oracle"], progress=False)
    assert table.row("oracle").frames == 3
    assert table.row("oracle").every.pixels == 2 * 256 * 256
    assert table.row("oracle", "60-80").frames == 1
    assert table.row("oracle", "80-100").every.pixels == 256 * 256
    assert table.row("oracle", "120-140").frames == 0
    assert math.isnan(table.row("oracle", "120-140").valid.mae_mm)


def test_photon_floor_is_a_row_that_shrinks_with_the_window(dataset):
    table = evaluate_depth(dataset, ["phase"], progress=False)
    one, five = (table.row(f"photon floor, {name}") for name in ("1 row", "5 rows"))
    assert one.every.rmse_mm / five.every.rmse_mm == pytest.approx(math.sqrt(5.0), rel=1e-6)
    # By hand at 70 and 90 mm: 100 grey values are 4118 electrons, contrast 0.6, variance 2.5² + 41.2²/12, 12.8 pixels.
    level, amplitude = 4118.0 + 147.5, 0.6 * 4118.0
    phase = 1.0 / math.sqrt(12.8 * (level - math.sqrt(level**2 - amplitude**2)))
    tau = 2.0 * math.tan(math.radians(30.0)) / 20
    sigma = [1e3 * tau * z**2 / (2.0 * math.pi * 0.005) * phase for z in (0.07, 0.09)]
    expected = math.sqrt(2.0 / math.pi) * np.mean(sigma)
    assert one.every.mae_mm == pytest.approx(expected, rel=0.05)  # the contrast as it is read from the image


def test_interval_is_over_tissues_and_the_same_each_time(pairs):
    first, second = (evaluate_depth(pairs, ["phase"], progress=False).row("phase") for _ in range(2))
    assert first == second
    low, high = first.every_interval.low.mae_mm, first.every_interval.high.mae_mm
    assert low < first.every.mae_mm < high
    one_tissue = evaluate_depth(pairs, ["phase"], progress=False, config=DepthEvaluation(bins_mm=(60.0, 95.0, 120.0)))
    assert math.isnan(one_tissue.row("phase", "60-95").every_interval.low.mae_mm)


def test_against_both_tells_the_references_error_from_the_models(pairs):
    table = evaluate_depth(pairs, ["oracle", "phase"], progress=False, config=DepthEvaluation(against="both"))
    assert table.row("oracle", against="exact").every.mae_mm == 0.0
    assert table.row("oracle", against="exact-at-zivid").every.mae_mm == 0.0
    oracle = table.row("oracle", against="zivid")
    assert oracle.every.mae_mm == pytest.approx(OFFSET_MM, abs=1e-3)  # mm; the plane's depth does not depend on the pixel
    reference = table.row("reference", against="exact-at-zivid")
    assert reference.every.mae_mm == pytest.approx(OFFSET_MM, abs=1e-3)
    assert reference.every.bias_mm == pytest.approx(OFFSET_MM, abs=1e-3)
    assert reference.every.pixels == oracle.every.pixels
    assert 0 < oracle.every.pixels < table.row("oracle", against="exact").every.pixels  # the reference sees a part of the image
    budget = table.error_budget()
    assert budget["reference_mae_mm"] == reference.every.mae_mm
    assert budget["models"]["oracle"] == {
        "against_zivid_mae_mm": oracle.every.mae_mm,
        "against_exact_mae_mm": 0.0,
    }


def test_residual_of_the_calibration_is_found_in_the_reference(pairs):
    config = DepthEvaluation(against="both", residual_mm=3.0, residual_deg=0.0, residual_seed=5)
    moved = config.residual.apply(np.eye(4))
    table = evaluate_depth(pairs, ["oracle"], progress=False, config=config)
    expected = OFFSET_MM + 1e3 * moved[2, 3]  # planes that face the scope feel only the shift along its axis
    assert table.row("reference").every.bias_mm == pytest.approx(expected, abs=1e-3)
    assert abs(expected - OFFSET_MM) > 0.1


def test_residual_has_exactly_the_asked_size():
    config = DepthEvaluation(against="zivid", residual_mm=1.0, residual_deg=0.15, residual_seed=3)
    true = np.eye(4)
    true[:3, 3] = [0.1, -0.2, 0.6]
    change = config.residual.apply(true) @ invert_transform(true)
    angle = math.degrees(math.acos(min(1.0, (np.trace(change[:3, :3]) - 1.0) / 2.0)))
    assert angle == pytest.approx(0.15, abs=1e-6)
    origin = transform_points(config.residual.apply(true), np.zeros(3))
    assert 1e3 * np.linalg.norm(origin - true[:3, 3]) == pytest.approx(1.0, abs=1e-9)
    assert not np.array_equal(
        config.residual.apply(true),
        DepthEvaluation(against="zivid", residual_mm=1.0, residual_deg=0.15, residual_seed=4).residual.apply(true),
    )


def test_monocular_rows_are_raw_and_fitted(pairs, register):
    class Guess(torch.nn.Module):
        """Says that the right of the image is nearer, on a scale of its own."""

        config = SimpleNamespace(image_size=32)

        def forward(self, pixel_values):
            return SimpleNamespace(predicted_depth=pixel_values[:, 0] + torch.linspace(0.0, 1.0, 32))

    register("guess", lambda rig: MonocularEstimator(rig, Guess(), MODELS["dpt"]))
    table = evaluate_depth(pairs, ["guess"], progress=False, config=DepthEvaluation(against="both"))
    for against in ("zivid", "exact-at-zivid", "exact"):
        assert table.row("guess raw", against=against).every.mae_mm > 1.0
        # A plane is fitted by the shift alone, to each truth anew.
        assert table.row("guess fitted", against=against).every.mae_mm < 0.01


def test_every_frame_is_estimated_with_its_own_rig(dataset, register, monkeypatch):
    seen = []

    class Spy(PhaseEstimator):
        def estimate(self, image):
            seen.append(self.rig.baseline_m)
            return super().estimate(image)

    register("spy", lambda rig: Spy(rig=rig))
    original = FrameStore.rig

    def rig(self, index):
        nominal = original(self, index)
        return Rig(camera=nominal.camera, baseline_m=0.004 + 0.0005 * index, mask=nominal.mask)

    monkeypatch.setattr(FrameStore, "rig", rig)
    evaluate_depth(dataset, ["spy"], progress=False, config=DepthEvaluation(floor_rows=()))
    assert seen == pytest.approx([0.004, 0.0045, 0.005])


def test_estimators_are_made_once_a_rig_and_not_kept_without_end(register):
    rig, made = Rig.from_optics(ScopeOptics()), []
    register("mine", lambda rig: made.append(rig) or PhaseEstimator(rig=rig))
    cache = EstimatorCache(["mine"])
    rigs = [Rig(camera=rig.camera, baseline_m=0.004 + 1e-5 * number, mask=rig.mask) for number in range(20)]
    for _ in range(2):
        assert cache.all(rigs[0]) is cache.all(rigs[0])
    assert len(made) == 1
    for one in rigs:
        cache.all(one)
    assert len(cache._by_rig) == 16


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda depth, valid: DepthEstimate(depth_mm=depth * np.nan, valid=valid), "finite and above 0 where valid is True"),
        (lambda depth, valid: DepthEstimate(depth_mm=-depth, valid=valid), "finite and above 0 where valid is True"),
        (lambda depth, valid: DepthEstimate(depth_mm=depth[:9], valid=valid[:9]), "shape of the estimate"),
        (lambda depth, valid: (depth, valid), "estimate is 'tuple'"),
        (lambda depth, valid: None, "estimate is 'nothing'"),
    ],
)
def test_what_an_estimator_returns_is_checked(dataset, register, returned, message):
    class Broken:
        def __init__(self, rig):
            pass

        def estimate(self, image):
            return returned(np.full(image.shape, 90.0, np.float32), np.ones(image.shape, bool))

    register("broken", Broken)
    with pytest.raises(InvalidValueError, match=message):
        evaluate_depth(dataset, ["broken"], progress=False)


def test_table_is_written_as_json_csv_and_markdown(dataset, tmp_path):
    evaluate_depth(dataset, ["oracle", "phase"], tmp_path / "out", progress=False)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["depth.csv", "depth.json", "depth.md"]
    plain = json.loads((tmp_path / "out" / "depth.json").read_text())
    assert plain["frames"] == 3
    assert "NaN" not in (tmp_path / "out" / "depth.json").read_text()
    assert {row["model"] for row in plain["rows"]} == {"oracle", "phase", "photon floor, 1 row", "photon floor, 5 rows"}
    assert {
        "against",
        "mae_mm",
        "mae_mm_low",
        "abs_rel",
        "acc_1_1",
        "acc_1_21",
        "rmse_mm",
        "beyond_20mm",
        "valid_mae_mm",
    } <= set(plain["rows"][0])
    assert len((tmp_path / "out" / "depth.csv").read_text().splitlines()) == 1 + 4 * 5
    text = (tmp_path / "out" / "depth.md").read_text()
    assert "## Against exact" in text
    assert "| oracle | 0.00 (0.00 to 0.00) |" in text


def test_budget_is_written_with_the_table(pairs, tmp_path):
    evaluate_depth(pairs, ["oracle"], tmp_path / "out", progress=False, config=DepthEvaluation(against="both"))
    assert "| oracle | 2.00 mm | 0.00 mm |" in (tmp_path / "out" / "depth.md").read_text()


def test_unknown_model_and_empty_split_are_refused(dataset):
    with pytest.raises(UnknownNameError, match="guess"):
        evaluate_depth(dataset, ["guess"], progress=False)
    with pytest.raises(InvalidValueError, match="train"):
        evaluate_depth(dataset, ["oracle"], config=DepthEvaluation(split="train"), progress=False)
    for names in ([], ["oracle", "oracle"]):
        with pytest.raises(InvalidValueError, match="one name or more"):
            evaluate_depth(dataset, names, progress=False)


def test_weights_of_a_model_that_is_not_evaluated_are_refused(dataset, tmp_path):
    with pytest.raises(InvalidValueError, match="weights for"):
        evaluate_depth(dataset, ["oracle"], config=DepthEvaluation(weights={"compact": tmp_path}), progress=False)
    with pytest.raises(MissingFileError):
        evaluate_depth(dataset, ["compact"], config=DepthEvaluation(weights={"compact": tmp_path / "none"}), progress=False)


def test_data_set_without_a_reference_camera_has_none_to_measure_against(dataset):
    with pytest.raises(InvalidValueError, match="no reference camera"):
        evaluate_depth(dataset, ["oracle"], config=DepthEvaluation(against="zivid"), progress=False)


def test_folder_that_cannot_be_written_is_an_output_error(dataset, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        evaluate_depth(dataset, ["oracle"], tmp_path / "file" / "out", progress=False)


@pytest.mark.parametrize(
    "change",
    [
        {"split": "x"},
        {"against": "x"},
        {"nearest_mm": 150.0},
        {"bins_mm": (60.0,)},
        {"bins_mm": (80.0, 60.0)},
        {"floor_rows": (0,)},
        {"residual_mm": 1.0},
        {"against": "zivid", "residual_mm": -1.0},
        {"against": "zivid", "residual_deg": 31.0},
        {"resamples": 0},
        {"examples": 21},
    ],
)
def test_impossible_configuration_is_refused(change):
    with pytest.raises(LaploopError, match=next(reversed(change)).removesuffix("_mm")):
        DepthEvaluation(**change)
