import json

from laploop.cli.main import main
from laploop.studies.doctor import checks, run


def test_the_findings_are_told_as_json_without_the_users_folder(capsys, monkeypatch):
    monkeypatch.setattr(run, "LOOP_S", 0.1)
    monkeypatch.setenv("HOME", str(checks.Path.home()))
    assert main(["doctor", "--json"]) == 0
    text = capsys.readouterr().out
    found = json.loads(text)
    assert found["GPU"]["verdict"] == "good"
    assert found["laploop"]["found"]
    assert " of real time over " in found["loop"]["found"]
    assert found["compiled kernels"]["verdict"] == "good"
    assert f"{checks.Path.home()}/" not in text


def test_what_is_missing_is_told_with_the_command_that_mends_it(monkeypatch):
    have = checks.version

    def without(name):
        if name in {"plotly", "zarr"}:
            raise checks.PackageNotFoundError(name)
        return have(name)

    monkeypatch.setattr(checks, "version", without)
    found = {check.name: check for check in checks.checks()}
    assert (found["zarr"].verdict, found["zarr"].remedy) == ("bad", "pip install --upgrade laploop")
    assert (found["extra report"].verdict, found["extra report"].remedy) == ("optional", "pip install 'laploop[report]'")
    assert found["extra report"].found == "without plotly"
    # With something that it needs missing, the loop is not tried.
    assert "loop" not in {check.name for check in run.examine()}


def test_a_loop_that_fails_is_a_finding(monkeypatch):
    from laploop.envs import episode

    def fails(*_arguments, **_more):
        raise RuntimeError("no physics today")

    monkeypatch.setattr(episode, "run_episode", fails)
    monkeypatch.setattr(run, "checks", lambda: iter(()))
    (check,) = run.examine()
    assert (check.verdict, check.found) == ("bad", "RuntimeError: no physics today")


def test_a_full_disk_is_named(monkeypatch):
    usage = checks.shutil.disk_usage("/")
    monkeypatch.setattr(checks.shutil, "disk_usage", lambda folder: usage._replace(free=10**8))
    (here, _, _) = checks._disk()
    assert (here.verdict, here.remedy) == ("bad", "make room: at least 2 GB")
