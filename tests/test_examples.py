import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_are_examples():
    assert EXAMPLES


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_every_example_draws_its_picture(path, tmp_path):
    picture = tmp_path / "picture.png"
    command = [sys.executable, "-P", str(path), "--picture", str(picture)]
    subprocess.run(command, cwd=tmp_path, capture_output=True, check=True)  # noqa: S603  our own scripts
    assert picture.stat().st_size > 5_000


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_every_example_begins_with_a_title(path):
    title, line, *_ = path.read_text().removeprefix('"""').splitlines()
    assert line == "=" * len(title)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_every_example_runs_from_any_folder(path, tmp_path):
    done = subprocess.run(  # noqa: S603  our own scripts
        [sys.executable, "-P", str(path), "--steps", "10"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
