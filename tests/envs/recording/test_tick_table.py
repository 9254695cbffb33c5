import numpy as np
import pytest
from pyarrow import parquet

from laploop.assets.shafts import INSTRUMENT
from laploop.envs.recording.tick_table import TickTable


@pytest.fixture
def table(tmp_path):
    def read(ticks):
        ticks.write(tmp_path / "ticks.parquet")
        return parquet.read_table(tmp_path / "ticks.parquet").to_pylist()

    return read


def vector(row, name, unit):
    return np.array([row[f"{name}_{axis}_{unit}"] for axis in "xyz"])


def test_a_row_holds_what_was_true_when_its_command_was_given(task_env, table):
    env = task_env("reach")
    env.reset(seed=3)
    ticks, command = TickTable(), np.array([0.01, 0.0, -0.02])
    tips, truths, normals = [], [], []
    for _ in range(3):
        _, normal, truth = env.target_offset()
        tips.append(env.loop.theatre.tip_in_world())
        truths.append(truth)
        normals.append(normal)
        predicted = np.array([0.001, 0.002, 0.08])
        ticks.begin(env, command, predicted)
        *_, info = env.step(command.astype(np.float32))
        ticks.end(info)
    rows = table(ticks)
    assert [round(row["time_s"] * 1e3) for row in rows] == [40, 48, 56]
    assert [row["depth_age_ms"] for row in rows] == [40.0, 48.0, 56.0]
    for row, tip, truth, normal in zip(rows, tips, truths, normals, strict=True):
        np.testing.assert_array_equal(vector(row, "tip", "m"), tip)
        np.testing.assert_array_equal(vector(row, "truth", "m"), truth)
        np.testing.assert_allclose(vector(row, "goal", "m"), truth + INSTRUMENT.tip_radius_m * normal, atol=1e-12)
        np.testing.assert_array_equal(vector(row, "command", "mps"), command)
        error = tip - truth - INSTRUMENT.tip_radius_m * normal
        assert row["error_along_mm"] == pytest.approx(error @ normal * 1e3)
        assert np.hypot(row["error_along_mm"], row["error_across_mm"]) == pytest.approx(np.linalg.norm(error) * 1e3)
        pose = env.loop.theatre.world_from_camera()
        np.testing.assert_allclose(vector(row, "prediction", "m"), pose[:3, :3] @ predicted + pose[:3, 3], atol=1e-12)
        assert (row["status"], row["fault"], row["contact_force_n"]) == ("tracking", None, 0.0)
    # It moves as commanded: 2 mm/s and more after two periods.
    assert np.linalg.norm(vector(rows[2], "tip_velocity", "mps")) > 2e-3


def test_without_a_prediction_its_cells_are_empty(task_env, table):
    env = task_env("reach", bad_action="hold")
    env.reset(seed=3)
    ticks = TickTable()
    ticks.begin(env, np.full(3, np.nan), None)
    *_, info = env.step(np.full(3, np.nan, np.float32))
    ticks.end(info)
    (row,) = table(ticks)
    assert row["prediction_x_m"] is None
    assert row["command_x_mps"] is None
    assert row["fault"] == "action_not_finite"
