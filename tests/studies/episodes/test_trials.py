import json
from dataclasses import replace

import pytest

from laploop.cli.main import main
from laploop.envs import episode
from laploop.envs.episode_config import EpisodeConfig
from laploop.errors import InvalidValueError, LaploopError, MissingFileError, SimulationError
from laploop.studies.episodes import trials
from laploop.studies.episodes.trials import COLUMNS, TrialsConfig, as_csv, as_markdown, run_trials, summarise, wilson_interval
from laploop.studies.episodes.trials_figure import draw_trials

EPISODE = EpisodeConfig.of(perception="oracle", seconds=1.0)


def row_for(episode):
    """Stand in for an episode: even seeds succeed."""
    summary = {
        "success": episode.seed % 2 == 0,
        "terminated_by": "success" if episode.seed % 2 == 0 else "time",
        "sim_s": 2.0,
        "target_error_mm": {"final": 0.1 * (1 + episode.seed)},
        "contact_force_n": {"max": 0.5},
        "rcm_error_mm": {"camera_max": 0.01, "tool_max": 0.1 * episode.seed},
        "port_force_n": {"camera_max": 0.02, "tool_max": 0.1 * episode.seed},
        "limits": {"shaft_room_mm": 30.0 - episode.seed},
        "depth_mae_mm": 0.5,
        "depth_valid_fraction": 0.9,
        "real_time_factor": 0.5,
    }
    return trials.row_of(episode.seed, summary)


def test_rows_come_in_the_order_of_seeds(tmp_path):
    config = TrialsConfig(episode=replace(EPISODE, seed=4), seeds=3)
    assert [row["seed"] for row in run_trials(config, tmp_path, run=row_for)] == [4, 5, 6]


@pytest.mark.slow  # each worker imports everything
def test_two_workers_give_the_same_rows_as_one(tmp_path):
    config = TrialsConfig(episode=EPISODE.changed(seconds=0.1), seeds=2)
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    alone = run_trials(config, tmp_path / "one")
    together = run_trials(replace(config, workers=2), tmp_path / "two")
    for row in (*alone, *together):
        del row["real_time_factor"]
    assert together == alone


def test_finished_episodes_are_not_run_again(tmp_path):
    seen = []

    def run(episode):
        seen.append(episode.seed)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return row_for(episode)

    config = TrialsConfig(episode=EPISODE, seeds=4)
    with pytest.raises(KeyboardInterrupt):
        run_trials(config, tmp_path, run=run)
    counts = []
    rows = run_trials(config, tmp_path, counts.append, run=run)
    assert seen == [0, 1, 2, 2, 3]
    assert counts == [2, 3, 4]
    assert len(rows) == 4


def test_rows_of_another_configuration_are_not_taken(tmp_path):
    run_trials(TrialsConfig(episode=EPISODE, seeds=2), tmp_path, run=row_for)
    seen = []
    other = TrialsConfig(episode=EPISODE.changed(motion="both"), seeds=2)
    run_trials(other, tmp_path, run=lambda episode: seen.append(episode.seed) or row_for(episode))
    assert seen == [0, 1]


def test_rows_of_other_code_are_not_taken(tmp_path, monkeypatch):
    config = TrialsConfig(episode=EPISODE, seeds=2)
    run_trials(config, tmp_path, run=row_for)
    monkeypatch.setattr(trials, "code_digest", lambda _study: "another")
    seen = []
    run_trials(config, tmp_path, run=lambda episode: seen.append(episode.seed) or row_for(episode))
    assert seen == [0, 1]


def test_failed_episode_is_a_row_without_success_and_is_tried_again(tmp_path, monkeypatch):
    def fail(_episode):
        raise SimulationError("MuJoCo warned of BADQACC")

    monkeypatch.setattr(episode, "run_episode", fail)
    config = TrialsConfig(episode=EPISODE, seeds=1)
    (row,) = run_trials(config, tmp_path)
    assert (row["success"], row["terminated_by"], row["error"]) == (False, "error", "MuJoCo warned of BADQACC")
    (row,) = run_trials(config, tmp_path, run=row_for)
    assert row["success"]


def test_error_that_every_episode_would_meet_stops_the_trials(tmp_path):
    def without_weights(_episode):
        raise MissingFileError("weights", "compact.safetensors", "train them")

    with pytest.raises(LaploopError, match="weights not found at compact"):
        run_trials(TrialsConfig(episode=EPISODE, seeds=2), tmp_path, run=without_weights)


@pytest.mark.parametrize("damaged", ["{", "[]", "null", "{}", '{"row": 3}', "\udcff"])
def test_damaged_row_is_named(tmp_path, damaged):
    run_trials(TrialsConfig(episode=EPISODE, seeds=1), tmp_path, run=row_for)
    (kept,) = (tmp_path / "rows").iterdir()
    kept.write_text(damaged, errors="surrogateescape")
    with pytest.raises(InvalidValueError, match="seed_000000"):
        run_trials(TrialsConfig(episode=EPISODE, seeds=1), tmp_path, run=row_for)


@pytest.mark.parametrize("field", ["seeds", "workers"])
def test_counts_below_one_are_refused(field):
    with pytest.raises(InvalidValueError, match=f"{field} is 0"):
        TrialsConfig(**{field: 0})


def test_summary_adds_rows_up(tmp_path):
    rows = [row_for(replace(EPISODE, seed=seed)) for seed in range(4)]
    failed = {**dict.fromkeys(COLUMNS), "seed": 4, "success": False, "terminated_by": "error", "error": "x"}
    summary = summarise([*rows, failed])
    assert summary["success_rate"] == pytest.approx(2 / 5)
    assert summary["terminated_by"] == {"success": 2, "time": 2, "error": 1}
    assert summary["final_error_mm"] == pytest.approx({"mean": 0.25, "median": 0.25, "p95": 0.385, "max": 0.4})
    assert summary["rcm_error_mm"] == pytest.approx({"camera_max": 0.01, "tool_max": 0.3})
    assert summary["port_force_n"]["max"] == pytest.approx(0.3)
    assert summary["limits"]["shaft_room_mm"] == {"mean": 28.5, "min": 27.0, "max": 30.0}
    assert as_csv(rows).splitlines()[0] == ",".join((*COLUMNS, "shaft_room_mm"))
    assert "Success 40.0 %" in as_markdown([*rows, failed], summary)
    draw_trials([*rows, failed], "title", tmp_path / "trials.png")
    assert (tmp_path / "trials.png").read_bytes().startswith(b"\x89PNG")


def test_a_tasks_own_metrics_are_added_up_and_become_columns():
    rows = [
        {**row_for(replace(EPISODE, seed=seed)), "metrics": {"standoff_rms_mm": rms}} for seed, rms in enumerate((0.2, 0.4))
    ]
    never_began = {**row_for(replace(EPISODE, seed=2)), "metrics": {"standoff_rms_mm": None}}
    rows.append(never_began)
    summary = summarise(rows)
    assert summary["metrics"]["standoff_rms_mm"] == pytest.approx({"mean": 0.3, "min": 0.2, "max": 0.4})
    header, first, *_, last = as_csv(rows).splitlines()
    assert header.endswith(",standoff_rms_mm,shaft_room_mm")
    assert first.endswith(",0.2,30.0")
    assert last.endswith(",,28.0")
    assert "| standoff_rms_mm | 0.3 | 0.2 | 0.4 |" in as_markdown(rows, summary)
    assert summarise([never_began])["metrics"]["standoff_rms_mm"]["mean"] is None


def test_wilson_interval_matches_its_published_values():
    # 29 of 30: 83.3 to 99.4 %; none of 10: 0 to 27.8 %
    assert wilson_interval(29, 30) == pytest.approx((0.833, 0.994), abs=5e-4)
    assert wilson_interval(0, 10) == pytest.approx((0.0, 0.278), abs=5e-4)


def test_command_runs_real_episodes_and_goes_on_where_it_was(tmp_path, capsys, monkeypatch):
    arguments = ["trials", "--perception", "oracle", "--seconds", "0.1", "--seeds", "2", "--out", str(tmp_path)]
    assert main(arguments) == 0
    first = json.loads((tmp_path / "summary.json").read_text())
    assert (first["episodes"], first["success_rate"], first["terminated_by"]) == (2, 0.0, {"time": 2})
    monkeypatch.setattr(episode, "run_episode", lambda _: pytest.fail("an episode was run again"))
    assert main(arguments) == 0
    assert json.loads((tmp_path / "summary.json").read_text())["rows"] == first["rows"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rows", "summary.json", "trials.csv", "trials.md", "trials.png"]
    assert "final target error, mean" in capsys.readouterr().out


def test_command_fails_when_an_episode_could_not_be_run(tmp_path, monkeypatch):
    def fail(_episode):
        raise SimulationError("broken")

    monkeypatch.setattr(episode, "run_episode", fail)
    assert main(["trials", "--perception", "oracle", "--seeds", "1", "--out", str(tmp_path)]) == 1
    assert "broken" in (tmp_path / "trials.csv").read_text()


@pytest.mark.parametrize("name", ["weights", "phantom"])
def test_rows_are_kept_by_the_content_of_files_not_by_their_path(tmp_path, name):
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("one")
    config = TrialsConfig(episode=EPISODE.changed(**{name: first}), seeds=2)
    rows = run_trials(config, tmp_path, run=row_for)

    def never(_episode):
        raise AssertionError

    assert run_trials(config, tmp_path, run=never) == rows
    first.rename(second)
    assert run_trials(replace(config, episode=EPISODE.changed(**{name: second})), tmp_path, run=never) == rows
    first.write_text("another")
    with pytest.raises(AssertionError):
        run_trials(config, tmp_path, run=never)
