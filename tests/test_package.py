"""What users install: sdist and wheel, built and tried outside the repository."""

import json
import subprocess
import sys
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


def test_an_installed_wheel_works_outside_the_repository(wheels, tmp_path):
    environment, place = tmp_path / "environment", tmp_path / "elsewhere"
    place.mkdir()
    run(sys.executable, "-m", "venv", environment, cwd=tmp_path)
    python, laploop = environment / "bin" / "python", environment / "bin" / "laploop"
    install = ("install", "--quiet", "--disable-pip-version-check", "--constraint", ROOT / "constraints.txt", wheels[1])
    run(python, "-m", "pip", *install, cwd=place)
    assert "commands:" in run(laploop, "--help", cwd=place, capture_output=True).stdout
    run(python, "-c", "import laploop.envs; laploop.envs.EpisodeConfig()", cwd=place)
    run(laploop, "run", "--task", "reach", "--seconds", "1", "--out", place / "run", cwd=place, capture_output=True)
    assert json.loads((place / "run" / "summary.json").read_text())["sim_s"] >= 1.0
