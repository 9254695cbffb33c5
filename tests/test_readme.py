import re
import tomllib
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_the_python_example_of_the_readme_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    assert len(example.strip().splitlines()) <= 10
    exec(compile(example, "README.md", "exec"), {})  # noqa: S102  our own text
    assert capsys.readouterr().out.strip()


def test_the_readme_is_short():
    assert len(README.split()) <= 900


def test_the_citation_names_the_version_of_the_package():
    citation = (ROOT / "CITATION.cff").read_text()
    (version,) = re.findall(r"^version: (.+)$", citation, flags=re.MULTILINE)
    assert version == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_the_animation_of_the_readme_is_small_and_shows_some_seconds():
    (name,) = re.findall(r"!\[.*\]\((.+\.webp)\)", README)
    assert (ROOT / name).stat().st_size < 3e6
    with Image.open(ROOT / name) as picture:
        pictures = picture.n_frames
        picture.seek(1)
        picture.load()
        assert 4.0 <= 1e-3 * pictures * picture.info["duration"] <= 6.0
