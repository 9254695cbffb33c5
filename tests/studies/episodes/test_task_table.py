import json
import math
from dataclasses import replace

import pytest

from laploop.cli.commands import tasks as command
from laploop.cli.main import main
from laploop.envs.episode import EpisodeConfig
from laploop.envs.fidelity import with_fidelity
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.episodes.task_campaigns import CAMPAIGNS, Campaign, Check, column_value
from laploop.studies.episodes.task_table import TaskTableConfig, run_task_table, summarise_tasks, table_csv, table_markdown

LIMITS = {
    "joint_position_share": 0.5,
    "joint_speed_share": 0.2,
    "command_speed_share": 0.4,
    "command_acceleration_share": 0.7,
    "shaft_room_mm": 30.0,
    "wall_room_mm": 60.0,
    "collision_steps": 0,
}


def made_row(seed, *, rms=0.3, success=True, **changes):
    row = {
        "seed": seed,
        "success": success,
        "terminated_by": "time",
        "sim_s": 20.0,
        "final_error_mm": 0.5,
        "contact_force_n": 0.0,
        "rcm_camera_mm": 0.01,
        "rcm_tool_mm": 0.1,
        "port_force_n": 0.2,
        "depth_mae_mm": 0.5,
        "depth_valid_fraction": 0.9,
        "real_time_factor": 0.5,
        "error": None,
        "metrics": {"normal_rms_mm": rms, "lateral_rms_mm": 0.1},
        "limits": dict(LIMITS),
    }
    return row | changes


def check_of(summary, campaign, name):
    (line,) = (line for line in summary["campaigns"] if line["campaign"] == campaign)
    (check,) = (check for check in line["checks"] if check["name"] == name)
    return check


def tracks(with_mm, without_mm):
    return {
        "track-oracle": [made_row(seed, rms=rms) for seed, rms in enumerate(with_mm)],
        "track-oracle-unpredicted": [made_row(seed, rms=rms) for seed, rms in enumerate(without_mm)],
    }


def test_every_task_is_measured_with_an_ideal_arm_and_a_real_one():
    measured = {(campaign.episode.task.kind, campaign.episode.actuation_name()) for campaign in CAMPAIGNS}
    assert measured == {(task, arm) for task in ("reach", "track", "palpate", "scan", "look") for arm in ("ideal", "ur5-cb")}
    assert len({campaign.name for campaign in CAMPAIGNS}) == len(CAMPAIGNS)


def test_tracking_is_measured_at_100_ms_of_latency():
    for campaign in CAMPAIGNS:
        if campaign.episode.task.kind == "track":
            timing = campaign.episode.task.loop.timing
            assert timing.transfer.latency_ms + timing.service.latency_ms == 100.0


def test_comparisons_name_campaigns_that_exist():
    names = {campaign.name for campaign in CAMPAIGNS}
    compared = [check.relative_to for campaign in CAMPAIGNS for check in campaign.checks if check.relative_to is not None]
    assert len(compared) == 2
    assert set(compared) < names


def test_errors_of_the_episodes_are_pooled_and_compared_with_those_without_prediction():
    summary = summarise_tasks(tracks([0.3, 0.4], [1.5, 2.0]))
    rms = check_of(summary, "track-oracle", "RMS error along the normal")
    assert rms["value"] == pytest.approx(math.sqrt((0.09 + 0.16) / 2.0))
    assert (rms["met"], rms["spread"]) == (True, {"min": 0.3, "max": 0.4})
    gain = check_of(summary, "track-oracle", "gain over track-oracle-unpredicted")
    assert gain["value"] == pytest.approx(5.0)
    assert gain["met"] is True
    assert summary["met"] is True
    assert check_of(summary, "track-oracle-unpredicted", "RMS error along the normal")["met"] is None


def test_a_missed_target_shows():
    summary = summarise_tasks(tracks([0.6, 0.6], [1.2, 1.2]))
    assert check_of(summary, "track-oracle", "RMS error along the normal")["met"] is False
    assert check_of(summary, "track-oracle", "gain over track-oracle-unpredicted")["met"] is False
    assert [line["met"] for line in summary["campaigns"]] == [False, True]
    assert summary["met"] is False
    text = table_markdown(summary)
    assert "| RMS error along the normal | rms | 0.6 mm | 0.6 | 0.6 | at most 0.5 mm | no |" in text
    assert "Success 100.0 % of 2 (95 %: 34.2 to 100.0 %)." in text


def test_comparison_with_a_campaign_that_was_not_run_says_nothing():
    alone = {"track-oracle": tracks([0.3], [])["track-oracle"]}
    gain = check_of(summarise_tasks(alone), "track-oracle", "gain over track-oracle-unpredicted")
    assert (gain["value"], gain["met"]) == (None, None)


def test_episode_that_ended_before_anything_could_be_measured_fails():
    rows = tracks([0.3, None], [2.0, 2.0])
    rms = check_of(summarise_tasks(rows), "track-oracle", "RMS error along the normal")
    assert (rms["missing"], rms["met"]) == (1, False)
    assert "0.3 mm (1 without)" in table_markdown(summarise_tasks(rows))


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"rcm_camera_mm": 0.21}, "trocar error, worst of both arms"),
        ({"limits": LIMITS | {"collision_steps": 1}}, "physics steps with a collision"),
        ({"limits": LIMITS | {"shaft_room_mm": -0.1}}, "room between the shafts"),
        ({"limits": LIMITS | {"wall_room_mm": -0.1}}, "room at the wall"),
        ({"limits": LIMITS | {"command_acceleration_share": 1.001}}, "greatest share of a joint's limits"),
        ({"limits": {}}, "room between the shafts"),
    ],
)
def test_one_bad_step_of_one_episode_is_seen(changes, name):
    rows = tracks([0.3, 0.3], [2.0, 2.0])
    rows["track-oracle"][1] |= changes
    summary = summarise_tasks(rows)
    assert check_of(summary, "track-oracle", name)["met"] is False
    assert summary["met"] is False


def test_a_real_arm_may_err_more_at_its_trocar():
    rows = {"track-ur5-cb": [made_row(0, rcm_tool_mm=0.4)]}
    assert check_of(summarise_tasks(rows), "track-ur5-cb", "trocar error, worst of both arms")["met"] is True


def test_episode_that_could_not_be_run_is_counted():
    failed = dict.fromkeys(made_row(1)) | {"seed": 1, "success": False, "error": "broken", "metrics": {}, "limits": {}}
    (line,) = summarise_tasks({"reach-still": [made_row(0), failed]})["campaigns"]
    assert (line["errors"], line["success_rate"], line["met"]) == (1, 0.5, False)
    assert "1 could not be run." in table_markdown({"campaigns": [line]})


def test_csv_has_a_line_a_number():
    summary = summarise_tasks(tracks([0.3], [2.0]))
    lines = table_csv(summary).splitlines()
    assert lines[0].startswith("campaign,episodes,success_rate,name,unit")
    assert len(lines) == 1 + sum(len(line["checks"]) for line in summary["campaigns"])
    assert "track-oracle,1,1.0,RMS error along the normal,mm,rms,0.3,0.3,0.3,0,at most 0.5 mm,True" in lines


def test_worst_of_several_columns():
    row = made_row(0)
    assert column_value(row, "rcm_mm") == 0.1
    assert column_value(row, "limit_share") == 0.7
    assert column_value(row | {"rcm_camera_mm": None, "rcm_tool_mm": None}, "rcm_mm") is None


def test_campaigns_are_chosen_by_name_and_wrong_ones_are_refused():
    assert [campaign.name for campaign in TaskTableConfig(only=("look", "reach-still")).campaigns()] == ["reach-still", "look"]
    assert TaskTableConfig().campaigns() == CAMPAIGNS
    with pytest.raises(UnknownNameError, match=r"unknown campaign 'dance'; available: .*reach-still"):
        TaskTableConfig(only=("dance",))
    with pytest.raises(InvalidValueError, match="seeds is 0"):
        TaskTableConfig(seeds=0)


def test_fidelity_changes_the_physics_of_every_campaign_and_nothing_else():
    full, fast = (TaskTableConfig(fidelity=name).campaigns() for name in ("full", "fast"))
    assert full == CAMPAIGNS
    for one, other in zip(full, fast, strict=True):
        assert other == replace(one, episode=replace(one.episode, task=with_fidelity(one.episode.task, "fast")))
        assert other != one


def test_a_real_campaign_goes_on_where_it_was(tmp_path):
    tiny = Campaign(
        name="tiny",
        about="",
        episode=EpisodeConfig.of(task="scan", perception="oracle", seconds=0.1),
        checks=(Check(name="scanned", column="path_progress", at_least=1.0),),
    )
    config, counts = TaskTableConfig(seeds=1, first_seed=3), []
    rows = run_task_table(config, tmp_path, counts.append, campaigns=(tiny,))
    summary = summarise_tasks(rows, (tiny,))
    checks = {check["name"]: check for check in summary["campaigns"][0]["checks"]}
    assert checks["scanned"]["met"] is False
    assert all(check["met"] is not False for name, check in checks.items() if name != "scanned")
    # Nothing is near anything in the first 0.1 s, and no joint stands at zero.
    assert checks["room between the shafts"]["value"] > 10.0
    assert checks["room at the wall"]["value"] > 10.0
    assert 0.1 < checks["greatest share of a joint's limits"]["value"] < 1.0
    again = run_task_table(config, tmp_path, counts.append, campaigns=(tiny,), run=lambda _: pytest.fail("run again"))
    assert again == rows
    assert counts == [0, 1, 1]


def test_command_writes_the_table(tmp_path, capsys, monkeypatch):
    def made(_config, _out, progress, _campaigns):
        progress(4)
        return tracks([0.3, 0.3], [0.6, 0.6])

    monkeypatch.setattr(command, "run_task_table", made)
    only = ["--only", "track-oracle", "track-oracle-unpredicted"]
    assert main(["tasks", "--seeds", "2", *only, "--out", str(tmp_path / "out")]) == 0
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [line["campaign"] for line in summary["campaigns"]] == only[1:]
    assert summary["met"] is False
    assert (tmp_path / "out" / "track-oracle" / "trials.csv").read_text().count("\n") == 3
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"tasks.md", "tasks.csv", "summary.json"}
    shown = capsys.readouterr().out
    assert "MISSES a target" in shown
    assert "gain over" in shown
