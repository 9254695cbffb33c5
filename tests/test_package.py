"""What users install: sdist and wheel, built and tried outside the repository."""

import json
import signal
import subprocess
import sys
import urllib.request
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


def run(*command, cwd, **options):
    return subprocess.run([str(part) for part in command], cwd=cwd, check=True, text=True, **options)  # noqa: S603


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """Build the wheel from the clone, and once more through the sdist."""
    direct, through = tmp_path_factory.mktemp("direct"), tmp_path_factory.mktemp("through")
    run(sys.executable, "-m", "build", "--wheel", "--outdir", direct, ROOT, cwd=direct, capture_output=True)
    run(sys.executable, "-m", "build", "--outdir", through, ROOT, cwd=through, capture_output=True)
    return next(direct.glob("*.whl")), next(through.glob("*.whl"))


def test_the_wheel_through_the_sdist_is_the_wheel_from_the_clone(wheels):
    direct, through = ({info.filename: info.CRC for info in zipfile.ZipFile(wheel).infolist()} for wheel in wheels)
    assert direct == through
    for folder in ("assets", "cli", "control", "envs", "perception", "studies"):
        assert f"laploop/{folder}/__init__.py" in direct


@pytest.fixture(scope="module")
def installed(wheels, tmp_path_factory):
    """Install the wheel into an empty environment, and return its folder of programs."""
    environment = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", environment, cwd=environment)
    programs = environment / "bin"
    install = ("install", "--quiet", "--disable-pip-version-check", "--constraint", ROOT / "constraints.txt", wheels[1])
    run(programs / "python", "-m", "pip", *install, cwd=environment)
    return programs


@pytest.fixture(scope="module")
def laploop(installed, tmp_path_factory):
    """Return what runs the installed command in a folder outside the repository and returns what it printed."""
    place = tmp_path_factory.mktemp("elsewhere")
    return lambda *arguments: run(installed / "laploop", *arguments, cwd=place, capture_output=True).stdout, place


def test_the_installed_package_imports_and_explains_itself(installed, laploop, tmp_path):
    command, _ = laploop
    assert "commands:" in command("--help")
    run(installed / "python", "-c", "import laploop.envs; laploop.envs.EpisodeConfig()", cwd=tmp_path)


def test_the_installed_doctor_finds_nothing_bad(laploop):
    command, _ = laploop
    found = json.loads(command("doctor", "--json"))
    assert {name for name, check in found.items() if check["verdict"] == "bad"} == set()
    assert "of real time" in found["loop"]["found"]


def test_the_installed_demo_and_a_run_write_their_recordings(laploop):
    command, place = laploop
    command("demo")
    assert json.loads((place / "laploop-demo" / "summary.json").read_text())["success"]
    command("run", "--task", "track", "--seconds", "1", "--out", "run")
    assert json.loads((place / "run" / "summary.json").read_text())["sim_s"] == 1.0
    for folder in ("laploop-demo", "run"):
        assert (place / folder / "recording.rrd").stat().st_size > 100_000


def test_the_installed_viewer_serves_a_page(installed, laploop):
    command, place = laploop
    command("run", "--perception", "oracle", "--seconds", "0.2", "--out", "seen")
    words = [installed / "laploop", "view", "--web", "seen"]
    with subprocess.Popen(words, cwd=place, stdout=subprocess.PIPE, text=True) as viewer:  # noqa: S603
        try:
            address = viewer.stdout.readline().strip()
            with urllib.request.urlopen(address, timeout=30) as page:  # noqa: S310  our own
                assert b"rerun" in page.read().lower()
        finally:
            viewer.send_signal(signal.SIGINT)
        assert viewer.wait(30) == 130


def test_installed_models_are_measured_on_pairs_that_were_collected_there(laploop):
    command, place = laploop
    command("collect", "--pairs", "3", "--tissues", "3", "--workers", "1", "--calibration-views", "5", "--out", "pairs")
    command("evaluate", "--dataset", "pairs", "--models", "phase", "compact", "--out", "table")
    assert "compact" in (place / "table" / "depth.md").read_text()
