"""Names of what laploop brings, what packages add, and what a user points at."""

import sys

import pytest

from laploop.errors import InvalidValueError, UnknownNameError
from laploop.registry import Registry


@pytest.fixture
def shapes():
    return Registry("shape", "laploop_test.shapes", {"ring": "collections:deque", "knot": 4})


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Install a package that adds one good and one broken shape by entry points."""
    (tmp_path / "shapes_of_mine.py").write_text("spiral = 'a spiral'\n")
    info = tmp_path / "shapes_of_mine-1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: shapes_of_mine\nVersion: 1\n")
    (info / "entry_points.txt").write_text(
        "[laploop_test.shapes]\nspiral = shapes_of_mine:spiral\nbroken = shapes_of_mine:missing\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("shapes_of_mine", None)


def test_built_in_entries_are_imported_when_asked_for(shapes):
    assert shapes.names() == ("ring", "knot")
    assert shapes.get("ring").__name__ == "deque"
    assert shapes.get("knot") == 4


def test_a_registered_entry_has_a_name_of_its_own(shapes):
    shapes.register("helix", 5)
    assert shapes.get("helix") == 5
    for taken in ("knot", "", "a:b"):
        with pytest.raises(InvalidValueError, match="name of the shape"):
            shapes.register(taken, 6)
    shapes.unregister("helix")
    assert "helix" not in shapes.names()


def test_packages_add_entries(shapes, package):
    assert shapes.names() == ("ring", "knot", "spiral", "broken")
    assert shapes.get("spiral") == "a spiral"


def test_a_broken_entry_names_itself_and_the_reason(shapes, package):
    with pytest.raises(InvalidValueError, match=r"shape is 'broken'.*has no attribute 'missing'"):
        shapes.get("broken")


def test_module_and_attribute_are_accepted_as_a_name(shapes, package):
    assert shapes.get("shapes_of_mine:spiral") == "a spiral"
    with pytest.raises(InvalidValueError, match=r"shape is 'no_such_module:x'.*ModuleNotFoundError"):
        shapes.get("no_such_module:x")


@pytest.mark.parametrize("name", ["rng", "a b:c", ":x", "x:", "os:1"])
def test_other_names_are_unknown(shapes, name):
    with pytest.raises(UnknownNameError, match="unknown shape"):
        shapes.get(name)


def test_the_nearest_name_is_suggested(shapes):
    with pytest.raises(UnknownNameError, match=r"unknown shape 'rng'; did you mean 'ring'\? available: knot, ring"):
        shapes.check("rng")


def test_entries_are_called_with_what_all_take_and_what_the_user_gives(shapes):
    assert list(shapes.make("ring", [1, 2, 3], maxlen=2)) == [2, 3]
    shapes.register("square", lambda side, *, unit="m": f"{side} {unit}")
    assert shapes.make("square", 2, unit="mm") == "2 mm"
    with pytest.raises(InvalidValueError, match=r"arguments of shape square is \['size'\]; allowed: those of square\(side"):
        shapes.make("square", 2, size=3)
    with pytest.raises(InvalidValueError, match="shape is 'knot'; allowed: a class or a function; it is of type int"):
        shapes.make("knot")
