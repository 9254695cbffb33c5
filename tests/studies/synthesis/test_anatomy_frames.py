"""Data sets with anatomy: which families and textures, which splits, and who may learn from them."""

from dataclasses import replace

import numpy as np
import pytest

from laploop.assets.anatomy.families.registry import family_names
from laploop.assets.anatomy.textures import texture_names
from laploop.assets.scope_optics import ScopeOptics
from laploop.assets.stripe_mask import StripeMask
from laploop.errors import InvalidValueError
from laploop.perception.data.frame_store import FrameStore
from laploop.studies.synthesis.config import TrainingFramesConfig
from laploop.studies.synthesis.run import render_training_frames

TINY = TrainingFramesConfig(
    train_tissues=2,
    val_tissues=0,
    test_tissues=0,
    frames_per_tissue=4,
    tool_share=0.5,
    workers=1,
    worlds=1.0,
    families=("strands", "wall"),
    optics=ScopeOptics(width=48, height=48, mask=StripeMask(stripes=8)),
)
HELD_OUT = replace(TINY, train_tissues=0, test_tissues=1, held_out=True, families=("stomach",))


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return FrameStore.open(render_training_frames(TINY, tmp_path_factory.mktemp("worlds") / "frames"))


def test_frames_know_what_they_show(store):
    assert store.done().all()
    assert {store.family(index) for index in range(len(store))} <= {"strands", "wall"}
    assert store.family(0) == TINY.world_of(0).family
    assert store.texture(5) == TINY.world_of(1).texture
    assert sum(store.tissues_by_family().values()) == 2
    assert np.isfinite(store.depth_mm(0)).mean() > 0.3


def test_frames_are_the_same_whoever_renders_them_and_in_whatever_order(store, tmp_path):
    again = FrameStore.open(render_training_frames(TINY, tmp_path / "frames"))
    (tmp_path / "frames" / "checksum" / "c.2.0").unlink()
    resumed = FrameStore.open(render_training_frames(TINY, tmp_path / "frames"))
    for index in range(len(store)):
        np.testing.assert_array_equal(again.image(index), store.image(index))
    np.testing.assert_array_equal(resumed.image(2), store.image(2))


def test_nothing_learns_from_what_is_held_out(store, tmp_path):
    store.check_learnable()
    held_out = FrameStore.open(render_training_frames(HELD_OUT, tmp_path / "frames"))
    assert held_out.indices("test").size == 4
    with pytest.raises(InvalidValueError, match=r"held-out families and textures of .*stomach"):
        held_out.check_learnable()


def test_worlds_are_drawn_by_fraction_and_leave_the_rest_as_it_was():
    plan = TrainingFramesConfig(worlds=0.7)
    worlds = [plan.world_of(tissue) for tissue in range(1000)]
    assert np.mean([world.family != "tissue" for world in worlds]) == pytest.approx(0.7, abs=0.05)
    assert {world.family for world in worlds} == {"tissue", *family_names(held_out=False)}
    assert {world.texture for world in worlds} == {"own", *texture_names(held_out=False)}
    assert {TrainingFramesConfig().world_of(tissue).family for tissue in range(100)} == {"tissue"}


def test_held_out_worlds_are_held_out_families_with_textures_of_both_kinds():
    plan = TrainingFramesConfig(train_tissues=0, val_tissues=0, held_out=True)
    worlds = [plan.world_of(tissue) for tissue in range(300)]
    assert {world.family for world in worlds} == set(family_names(held_out=True))
    unseen = np.mean([world.texture in texture_names(held_out=True) for world in worlds])
    assert unseen == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"families": ("stomach",), "worlds": 0.5}, "families is 'stomach'; allowed: with held_out False: bowel-loops"),
        ({"families": ("lobe",), "worlds": 0.5}, "unknown family of anatomy 'lobe'"),
        ({"families": ("lobes",)}, "none with worlds 0"),
        ({"held_out": True}, "0 and 0 with held_out"),
        ({"worlds": 1.5}, "worlds"),
    ],
)
def test_impossible_worlds_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        TrainingFramesConfig(**change)
