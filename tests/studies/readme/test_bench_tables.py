from laploop.studies.readme.bench_tables import against_table, bench_rows_table


def test_rows_stand_side_by_side_by_fidelity():
    summary = {
        "env_steps_per_s": {"full": {"state": {"single": 30.0}}, "fast": {"state": {"single": 81.25}}},
        "reset_ms": {"full": {"new": 150.4, "cached": 61.0}},
    }
    table = bench_rows_table(summary)
    assert "| env_steps_per_s state | 30 | 81.2 | steps of 40 ms a second |" in table
    assert "| reset_ms cached | 61 |  | ms |" in table


def test_a_bench_without_rows_gives_no_table():
    assert bench_rows_table({"stages": []}) is None


def test_ratios_show_their_quartiles_and_what_is_better():
    one = {"this": 1.0, "other": 2.0, "ratio": 0.5, "p25": 0.45, "p75": 0.55, "better": "less"}
    table = against_table({"physics_ms": {"full": {"free": one}, "fast": {"free": {**one, "ratio": 0.25}}}})
    assert "| physics_ms free | 0.50 (0.45 to 0.55) | 0.25 (0.45 to 0.55) | less |" in table
