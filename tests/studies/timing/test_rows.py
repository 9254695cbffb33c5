from laploop.studies.timing.bench_config import BenchConfig
from laploop.studies.timing.row_tables import nested
from laploop.studies.timing.rows import Row, memory_rows, rows


def test_every_row_has_keys_of_its_own():
    found = [row.path for row in rows(BenchConfig())]
    assert len(found) == len(set(found))


def test_rows_cover_observations_resets_and_episodes_in_both_fidelities():
    tree = nested({row.path: row.unit for row in rows(BenchConfig())})
    for fidelity in ("full", "fast"):
        steps = tree["env_steps_per_s"][fidelity]
        assert set(steps) == {"state", "stripes", "depth_oracle", "depth_compact"}
        assert all(set(each) == {"single", "vector_2", "vector_8", "vector_32"} for each in steps.values())
        assert set(tree["reset_ms"][fidelity]) == {"new", "cached"}
        assert tree["real_time_factor"][fidelity] == "of real time"


def test_only_what_was_chosen_is_measured():
    config = BenchConfig(fidelities=("fast",), observations=("stripes",))
    chosen = list(rows(config))
    assert {row.options["fidelity"] for row in chosen} == {"fast"}
    assert [row.options["observation"] for row in chosen if row.measure == "steps"] == ["stripes"]


def test_rate_is_units_a_second_and_the_rest_milliseconds_a_unit_of_the_chosen_clock():
    sample = {"units": 4, "wall_s": 2.0, "cpu_s": 1.0, "peak_mb": 300.0}
    common = {"path": ("a",), "measure": "steps", "options": {}, "unit": ""}
    assert Row(**common, rate=True).value(sample) == 2.0
    assert Row(**common).value(sample) == 500.0
    assert Row(**common, clock="cpu").value(sample) == 250.0
    assert Row(**common, key="peak_mb").value(sample) == 300.0


def test_memory_of_a_vector_is_that_between_its_smallest_and_its_largest():
    config = BenchConfig(fidelities=("fast",), vectors=(8, 2))
    paths = [row.path for together in memory_rows(config) for row in together]
    assert paths == [("memory_mb", "fast"), ("memory_resident_mb", "fast"), ("memory_per_environment_mb", "fast")]
    (row,) = list(memory_rows(config))[-1]
    assert (row.options["fewest"], row.options["most"]) == (2, 8)
    assert len(list(memory_rows(BenchConfig(fidelities=("fast",), vectors=())))) == 1
