"""Kept scenes change nothing but the time, and stay few."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.tissue_config import TissueConfig, TissueMaterial, TissueShape
from laploop.envs.theatre import scene
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.organ_motion import BaseMotion
from laploop.envs.theatre.scene_cache import BoundedCache
from laploop.envs.theatre.theatre import Theatre

COARSE = TheatreConfig(tissue=TissueConfig(shape=TissueShape(samples=31), cells=(4, 4)))


@pytest.fixture(autouse=True)
def empty(monkeypatch):
    """Begin without kept scenes."""
    monkeypatch.setattr(scene, "_TEMPLATES", BoundedCache(4))
    monkeypatch.setattr(scene, "_SCENES", BoundedCache(3))


def history(config, seed):
    """Return what a theatre does in its first steps."""
    theatre = Theatre(config, seed=seed)
    for _ in range(20):
        theatre.step()
    return np.concatenate([theatre.data.qpos, theatre.data.qvel, theatre.tissue.surface_points().ravel()])


def test_a_theatre_is_the_same_to_the_bit_whatever_was_built_before(monkeypatch):
    config = replace(COARSE, motion=BaseMotion.named("both"))
    first = history(config, 7)
    np.testing.assert_array_equal(history(config, 7), first)
    # After another seed, whose model is then the template.
    monkeypatch.setattr(scene, "_TEMPLATES", BoundedCache(4))
    monkeypatch.setattr(scene, "_SCENES", BoundedCache(3))
    assert (history(config, 8) != first).any()
    np.testing.assert_array_equal(history(config, 7), first)


def test_a_theatre_does_not_write_into_what_is_kept():
    theatre = Theatre(COARSE, seed=7)
    before = Theatre(COARSE, seed=7).model.flex_stiffness.copy()
    theatre.model.flex_stiffness[:] *= 2.0
    theatre.model.opt.gravity[:] = 0.0
    again = Theatre(COARSE, seed=7)
    np.testing.assert_array_equal(again.model.flex_stiffness, before)
    assert again.model.opt.gravity[2] == pytest.approx(-9.81)


@pytest.mark.parametrize(
    "change",
    [
        {"tissue": replace(COARSE.tissue, material=TissueMaterial(young_pa=20_000.0))},
        {"tissue": replace(COARSE.tissue, contact_every=2)},
        {"working_distance_m": 0.1},
        {"layout": replace(COARSE.layout, tool_base_x_m=0.74)},
    ],
)
def test_whatever_shapes_a_scene_makes_another(change):
    one, other = Theatre(COARSE, seed=7), Theatre(replace(COARSE, **change), seed=7)
    assert len(scene._SCENES) == 2
    same = one.model.nflexelem == other.model.nflexelem and np.array_equal(one.data.xpos, other.data.xpos)
    assert not same


def test_what_moves_a_scene_does_not_make_another():
    Theatre(COARSE, seed=7)
    Theatre(replace(COARSE, motion=BaseMotion.named("breathing")), seed=7)
    assert len(scene._SCENES) == 1


def test_only_the_newest_are_kept():
    cache = BoundedCache(2)
    made = []

    def make(key):
        made.append(key)
        return key

    for key in ("a", "b", "a", "c", "b", "a"):
        assert cache.get(key, lambda key=key: make(key)) == key
    # a was used again before c came, so that b had to go; then a.
    assert made == ["a", "b", "c", "b", "a"]
    assert len(cache) == 2


def test_threads_may_share_it():
    cache = BoundedCache(4)
    wrong = []

    def ask(offset):
        for k in range(2000):
            key = (k * offset) % 7
            if cache.get(key, lambda key=key: key) != key:
                wrong.append(key)

    threads = [threading.Thread(target=ask, args=(offset,)) for offset in (1, 2, 3, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
    assert len(cache) <= 4
