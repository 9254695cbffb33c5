import pytest

from laploop.errors import InvalidValueError, LaploopError, MissingFileError, UnknownNameError
from laploop.studies.sweeps.analyses.findings import analysis_named
from laploop.studies.sweeps.sweep_file import read_sweep, shipped_names

AXIS = "loop.timing.pipeline.latency_ms"


def test_lists_are_crossed_and_reach_their_paths(sweep_file):
    conditions = read_sweep(sweep_file()).conditions
    assert [tuple(one.values.values()) for one in conditions] == [(0, "none"), (0, "rate"), (50.0, "none"), (50.0, "rate")]
    assert [one.episode.task.loop.timing.pipeline.latency_ms for one in conditions] == [0.0, 0.0, 50.0, 50.0]
    assert [one.episode.predictor.name for one in conditions] == ["none", "rate", "none", "rate"]
    assert {one.episode.task.loop.timing.service.latency_ms for one in conditions} == {0.0}
    assert conditions[2].name == "latency_ms=50, prediction=none"


def test_named_conditions_have_lists_of_their_own_and_switches_double_them(sweep_file):
    more = """
[[conditions]]
name = "rates"
vary = {"loop.camera_hz" = [25.0, 50.0, 62.5]}

[[conditions]]
name = "beating"
set = {motion = "beating"}
vary = {}

[[switches]]
name = "late"
set = {"loop.timing.pipeline.latency_ms" = 20.0}
"""
    sweep = read_sweep(sweep_file(more=more))
    assert {name: len(part) for name, part in sweep.groups().items()} == {"rates": 6, "beating": 2}
    assert sweep.conditions[-1].values == {"late": "ideal"}
    assert sweep.conditions[-1].episode.task.loop.timing.pipeline.latency_ms == 20.0
    assert sweep.conditions[-1].episode.motion_name() == "beating"


def test_an_item_can_set_several_paths(sweep_file):
    item = '"pace" = [{label = 1, set = {}}, {label = 2, set = {"loop.camera_hz" = 50.0, seconds = 0.5}}]'
    conditions = read_sweep(sweep_file(('prediction = ["none", "rate"]', item))).conditions
    assert [one.values["pace"] for one in conditions] == [1, 2, 1, 2]
    assert [one.episode.task.max_seconds for one in conditions] == [0.3, 0.5, 0.3, 0.5]


def test_what_comes_later_counts_be_it_an_option_or_a_path(sweep_file):
    more = '\n[[conditions]]\nname = "late"\nset = {perception_latency_ms = 70.0, task = "palpate"}\n'
    (condition, *_) = read_sweep(sweep_file(("settle_s = 0.1", ""), more=more)).conditions
    assert condition.episode.task.loop.timing.service.latency_ms == 70.0
    assert condition.episode.task.kind == "palpate"


def test_seeds_have_bounds(sweep_file):
    with pytest.raises(InvalidValueError, match="seeds is 0"):
        read_sweep(sweep_file(), seeds=0)


def test_quick_takes_its_own_lists_and_seeds(sweep_file):
    path = sweep_file(more=f'\n[quick]\nseeds = 1\nvary = {{"{AXIS}" = [0]}}\n')
    assert read_sweep(path).count == 8
    assert read_sweep(path, quick=True).count == 2
    assert read_sweep(path, quick=True, seeds=5).count == 10


def test_pairing_decides_the_seeds(sweep_file):
    same = read_sweep(sweep_file()).conditions
    assert {one.first_seed for one in same} == {0}
    own = read_sweep(sweep_file(("seeds = 2", 'seeds = 2\npairing = "own-seeds"')), seeds=3).conditions
    assert [one.first_seed for one in own] == [0, 3, 6, 9]


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("pipeline.latency", "pipline.latency", r"own.toml, line 16: .*pipline.*did you mean 'pipeline'"),
        ("prediction =", "predicton =", r"line 17: .*'predicton'; did you mean 'prediction'"),
        ("[vary]", '[labels]\npredction = "how"\n\n[vary]', r"line 16: .*'predction'; did you mean 'prediction'"),
        ("[0, 50.0]", "[]", r"line 16: .*at least one value"),
        ("[0, 50.0]", "[0, -5]", r"line 16: .* is -5; allowed: 0 to 5000"),
        ("[0, 50.0]", "[0, nan]", r"line 16: .*nan.*finite"),
        ("[0, 50.0]", "[0, inf]", r"line 16: .*inf.*finite"),
        ("[0, 50.0]", "[0, 0.0]", r"line 16: .*0.0 is there twice"),
        ("seeds = 2", "seeds = 0", r"line 3: seeds is 0"),
        ("seeds = 2", "sedes = 2", r"line 3: .*did you mean 'seeds'"),
        ("force_max_n", "force", r"line 4: .*metric 'force'"),
        ("seeds = 2", 'analysis = "latncy"', r"line 3: .*did you mean 'latency'"),
        ("[vary]", "[vary", r"own.toml is .*line 15"),
        ("settle_s", "seed", r"line 10: seed is"),
        ('"none", "rate"', '"none", "os:getcwd"', r"line 17: .*--trust"),
        ("settle_s", "controller.arguments.max_age_s", r"line 10: .*max_age_s"),
        ("[0, 50.0]", "[0, {label = [1], set = {}}]", r"line 16: .*a label"),
        ("settle_s = 0.1", "loop.camera_hz = 26.0", r"line 10: .*nearest are 25 or 26.316 Hz"),
    ],
)
def test_bad_sweeps_are_refused_with_line_and_reason(sweep_file, before, after, message):
    with pytest.raises(LaploopError, match=message):
        read_sweep(sweep_file((before, after)))


@pytest.mark.parametrize("content", [b"latency_ms\n40\nfast\n", b"latency_ms\n40\n\n41\n", "latency_ms\n40\n".encode("utf-16")])
def test_bad_traces_are_refused_with_the_sweeps_line(sweep_file, tmp_path, content):
    (tmp_path / "trace.csv").write_bytes(content)
    with pytest.raises(InvalidValueError, match=r"own.toml, line 10: .*trace"):
        read_sweep(sweep_file(("settle_s = 0.1", 'latency_trace = "trace.csv"')))


def test_a_missing_trace_is_looked_for_beside_the_sweep(sweep_file, tmp_path):
    with pytest.raises(MissingFileError, match=rf"line 10: .*{tmp_path}/none.csv"):
        read_sweep(sweep_file(("settle_s = 0.1", 'latency_trace = "none.csv"')))


def test_conditions_of_equal_episodes_are_refused(sweep_file):
    item = "pace = [{label = 1, set = {}}, {label = 2, set = {}}]"
    with pytest.raises(InvalidValueError, match="episodes differ"):
        read_sweep(sweep_file(('prediction = ["none", "rate"]', item)))


def test_unknown_studies_are_refused():
    with pytest.raises(UnknownNameError, match="did you mean 'latency'"):
        read_sweep("latncy")


@pytest.mark.parametrize("name", shipped_names())
def test_shipped_sweeps_can_be_read(name, monkeypatch):
    monkeypatch.setattr("laploop.studies.sweeps.conditions.make_estimator", lambda *_: None)
    full, quick = read_sweep(name), read_sweep(name, quick=True)
    assert quick.count < full.count
    assert callable(analysis_named(full.analysis))
