import numpy as np
import pytest

from laploop.assets.phantom_import.solid_store import cache_folder, stored_solid

SURFACE = (np.eye(3), np.array([[0, 1, 2]], dtype=np.int32))


class Mesher:
    """Makes another solid at each call."""

    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return np.full((4, 3), float(self.calls)), np.array([[0, 1, 2, 3]], dtype=np.int32)


@pytest.fixture
def mesher(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return Mesher()


def test_equal_surfaces_and_recipes_give_equal_bits_from_the_cache(mesher):
    first, second = stored_solid(SURFACE, "recipe", mesher), stored_solid(SURFACE, "recipe", mesher)
    assert mesher.calls == 1
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == other.dtype
    assert [kept.suffix for kept in cache_folder().iterdir()] == [".npz"]
    stored_solid((2.0 * SURFACE[0], SURFACE[1]), "recipe", mesher)
    stored_solid(SURFACE, "another recipe", mesher)
    assert mesher.calls == 3


def test_damaged_copy_in_the_cache_is_made_anew(mesher):
    stored_solid(SURFACE, "recipe", mesher)
    (kept,) = cache_folder().iterdir()
    kept.write_bytes(b"PK broken")
    second, third = stored_solid(SURFACE, "recipe", mesher), stored_solid(SURFACE, "recipe", mesher)
    assert mesher.calls == 2
    np.testing.assert_array_equal(second[0], third[0])


def test_solid_is_made_anew_where_the_cache_cannot_be_written(mesher, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    stored_solid(SURFACE, "recipe", mesher)
    stored_solid(SURFACE, "recipe", mesher)
    assert mesher.calls == 2


def test_solid_that_another_process_kept_first_is_taken(mesher):
    inner = []

    def overtaken():
        inner.append(stored_solid(SURFACE, "recipe", mesher))
        return mesher()

    np.testing.assert_array_equal(stored_solid(SURFACE, "recipe", overtaken)[0], inner[0][0])
    assert mesher.calls == 2
