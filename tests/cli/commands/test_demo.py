import json

from laploop.cli.main import main


def test_a_demo_writes_a_run_where_it_is_started_and_fails_if_the_point_was_not_held(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seconds", "0.2"]) == 1
    assert capsys.readouterr().err.endswith("laploop demo: the point was not held to the end\n")
    summary = json.loads((tmp_path / "laploop-demo" / "summary.json").read_text())
    assert (summary["task"], summary["perception"], summary["motion"]) == ("reach", "compact", "breathing")
    assert summary["config"]["task"]["success_hold_s"] == 4.0
    assert (tmp_path / "laploop-demo" / "recording.rrd").is_file()
