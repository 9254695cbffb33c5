import pytest

from laploop.studies.timing.row_tables import nested, ratios_markdown, row_medians, row_ratios, rows_markdown
from laploop.studies.timing.rows import Row, RowResult

STEPS = Row(
    path=("env_steps_per_s", "fast", "state", "single"),
    measure="steps",
    options={"fidelity": "fast"},
    unit="steps of 40 ms a second",
    rate=True,
)
PHYSICS = Row(
    path=("physics_ms", "fast", "free"), measure="physics", options={"fidelity": "fast"}, unit="ms of CPU a 40 ms", clock="cpu"
)


def steps_sample(wall_s):
    """Two steps, of which physics takes 60 %."""
    each_ms = 1e3 * wall_s / 2
    stages = {"physics": 0.6 * each_ms, "other": 0.4 * each_ms}
    return {"units": 2, "wall_s": wall_s, "cpu_s": 1.0, "stage_ms": stages, "background_ms": {"perception": 7.0}}


def results():
    steps = RowResult(
        row=STEPS,
        samples=[steps_sample(0.02), steps_sample(0.04), steps_sample(0.02)],
        others=[steps_sample(0.08), steps_sample(0.16), steps_sample(0.08)],
        other_fidelity="full",
    )
    physics = RowResult(
        row=PHYSICS,
        samples=[{"units": 10, "wall_s": 9.0, "cpu_s": 0.2}],
        others=[{"units": 10, "wall_s": 9.0, "cpu_s": 0.4}],
        other_fidelity="fast",
    )
    return [steps, physics]


def test_tree_grows_from_paths():
    assert nested({("a", "b"): 1, ("a", "c"): 2, ("d",): 3}) == {"a": {"b": 1, "c": 2}, "d": 3}


def test_medians_stand_under_their_keys_and_their_spread_beside_them():
    written = row_medians(results())
    assert written["env_steps_per_s"]["fast"]["state"]["single"] == pytest.approx(100.0)
    # CPU time, not wall-clock time.
    assert written["physics_ms"]["fast"]["free"] == pytest.approx(20.0)
    spread = written["spread"]["env_steps_per_s"]["fast"]["state"]["single"]
    assert (spread["p25"], spread["p75"], spread["rounds"]) == (pytest.approx(75.0), pytest.approx(100.0), 3)


def test_stages_of_a_step_add_up_to_the_whole():
    written = row_medians(results())
    # Mean of 10, 20 and 10 ms.
    assert sum(written["step_ms"]["fast"]["state"].values()) == pytest.approx(40.0 / 3.0)
    assert written["background_ms"]["fast"]["state"] == {"perception": 7.0}
    row = next(line for line in rows_markdown(results()).splitlines() if line.startswith("| fast, state |"))
    assert row == "| fast, state | 8 | 5.33 | 13.3 |"


def test_ratios_say_which_way_is_better_and_how_the_other_ran():
    written = row_ratios(results())
    steps = written["env_steps_per_s"]["fast"]["state"]["single"]
    assert (steps["ratio"], steps["p25"], steps["p75"], steps["rounds"]) == (4.0, 4.0, 4.0, 3)
    assert (steps["this"], steps["other"]) == (pytest.approx(100.0), pytest.approx(25.0))
    assert (steps["better"], steps["other_fidelity"]) == ("more", "full")
    assert written["physics_ms"]["fast"]["free"]["ratio"] == 0.5
    table = ratios_markdown(results())
    assert "| 100 | 25 (full) | 4.00 | 4.00 to 4.00 | more | 3 |" in table
    assert "| physics_ms > fast > free [ms of CPU a 40 ms] | 20 | 40 | 0.50 |" in table
