import pytest

from laploop.studies.code_digest import code_digest, digest_of

FILES = {
    "errors.py": "one",
    "envs/loop/clock.py": "two",
    "envs/randomisation/wide.toml": "three",
    "assets/weights/net.safetensors": "four",
    "studies/demonstrations/expert.py": "five",
}
OTHERS = {
    "cli/main.py": "of no weight",
    "studies/timing/bench.py": "of no weight",
    "envs/tasks/README.md": "of no weight",
    "envs/loop/__pycache__/clock.cpython-311.pyc": "of no weight",
    "envs/loop/.clock.py.swp": "of no weight",
}


@pytest.fixture
def package(tmp_path):
    """A package whose floors are links, as in a checkout."""
    (tmp_path / "package" / "studies").mkdir(parents=True)
    for name in ("assets", "control", "envs", "perception", "cli"):
        (tmp_path / name).mkdir()
        (tmp_path / "package" / name).symlink_to(tmp_path / name)
    for name, text in {**FILES, **OTHERS}.items():
        path = tmp_path / "package" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "package"


@pytest.mark.parametrize("name", FILES)
def test_the_digest_changes_with_what_an_episode_depends_on(package, name):
    before = digest_of(package, "demonstrations")
    path = package / name
    text = path.read_text()
    path.write_text(f"{text}, changed")
    assert digest_of(package, "demonstrations") != before
    path.write_text(text)
    assert digest_of(package, "demonstrations") == before
    path.rename(path.with_name(f"moved_{path.name}"))
    assert digest_of(package, "demonstrations") != before


@pytest.mark.parametrize("name", OTHERS)
def test_the_digest_does_not_change_with_anything_else(package, name):
    before = digest_of(package, "demonstrations")
    (package / name).write_text("changed")
    assert digest_of(package, "demonstrations") == before


def test_the_digest_of_this_package_is_made_once():
    assert code_digest("demonstrations") is code_digest("demonstrations")
    assert len(code_digest("demonstrations")) == 64
