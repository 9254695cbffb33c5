import sys
from pathlib import Path

import pytest

from laploop.errors import InvalidValueError, MissingFileError, WorkerError
from laploop.studies.timing.probe_process import (
    ProbeProcess,
    checkout_source,
    start_fetch,
    start_probe,
    this_source,
)

ROOT = Path(__file__).parents[3]

ECHO = """
import json, os, sys
print(json.dumps({"hello": os.environ["XDG_CACHE_HOME"]}), flush=True)
for line in sys.stdin:
    request = json.loads(line)
    if request.get("block") == 3:
        sys.exit("the fourth is too much")
    print(json.dumps(request), flush=True)
"""


def echo(code=ECHO):
    return ProbeProcess("the echo", [sys.executable, "-c", code], {})


def test_questions_are_answered_one_by_one_until_the_process_is_closed():
    with echo() as probe:
        assert probe.prepare("steps", {"seed": 1}) == {"measure": "steps", "options": {"seed": 1}}
        assert probe.block(0) == {"block": 0}
        process, cache = probe._process, Path(probe.greeting["hello"])
        assert cache.is_dir()
    assert process.returncode == 0
    assert not cache.exists()


def test_a_process_that_fails_is_told_with_its_last_words():
    with echo() as probe, pytest.raises(WorkerError, match=r"measures the echo ended early: the fourth is too much"):
        probe.block(3)
    with pytest.raises(WorkerError, match="ended early: without a word"):
        echo("pass")
    with pytest.raises(WorkerError, match=r"cannot start /no/python to measure it: No such file"):
        ProbeProcess("it", ["/no/python"], {})


def test_checkout_is_found_by_its_package():
    assert checkout_source(ROOT) == ROOT / "src"
    assert this_source().resolve() == (ROOT / "src").resolve()


def test_what_is_no_checkout_is_refused(tmp_path):
    with pytest.raises(InvalidValueError, match=r"against is '.*nowhere'; allowed: the folder of another checkout"):
        checkout_source(tmp_path / "nowhere")
    with pytest.raises(MissingFileError, match=r"package laploop not found at .*; give the top folder of a checkout"):
        checkout_source(tmp_path)


def test_another_checkout_than_the_installed_one_is_measured(tmp_path):
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "laploop").symlink_to(this_source() / "laploop")
    with start_probe(tmp_path / "src", "the copy") as probe:
        assert Path(probe.greeting["source"]) == tmp_path / "src" / "laploop"


def test_a_package_that_cannot_be_imported_is_told(tmp_path):
    (tmp_path / "laploop").mkdir()
    (tmp_path / "laploop" / "__init__.py").write_text("raise ValueError('half a checkout')\n")
    with pytest.raises(WorkerError, match="measures the broken one ended early: ValueError: half a checkout"):
        start_probe(tmp_path, "the broken one")


def test_missing_interpreter_and_environment_without_fetch_are_told(tmp_path):
    with pytest.raises(MissingFileError, match=r"interpreter not found at .*none; give the bin/python"):
        start_fetch(tmp_path / "none")
    with pytest.raises(WorkerError, match="Fetch ended early: ModuleNotFoundError: No module named 'gymnasium_robotics'"):
        start_fetch(Path(sys.executable))
