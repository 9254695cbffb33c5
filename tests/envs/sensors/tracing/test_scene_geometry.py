from itertools import pairwise

import mujoco
import numpy as np
import pytest

from laploop.assets.tissue_appearance import TissueAppearance, tissue_albedo
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError

TRIANGLE = {"points": np.eye(3), "triangles": np.array([[0, 1, 2]]), "object_ids": ObjectId.TISSUE}


def test_model_geoms_get_their_class_and_only_visible_ones_count():
    xml = """
    <mujoco>
      <asset><mesh name="m" vertex="0 0 0  0.01 0 0  0 0.01 0  0 0 0.01"/></asset>
      <worldbody>
        <geom name="tool_arm/shaft" type="capsule" size="0.002 0.05" group="1"/>
        <geom name="stage/plate" type="box" size="0.1 0.1 0.001" pos="0 0 -0.1" group="1"/>
        <geom name="card" type="mesh" mesh="m" group="1"/>
        <geom name="hidden" type="sphere" size="0.01" group="2"/>
        <geom name="glass" type="sphere" size="0.01" rgba="1 1 1 0" group="1"/>
      </worldbody>
    </mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    scene = SceneGeometry.from_model(model)
    assert set(scene.object_ids.tolist()) == {ObjectId.TOOL, ObjectId.STAGE, ObjectId.OTHER}
    assert (scene.object_ids == ObjectId.STAGE).sum() == 12
    assert (scene.object_ids == ObjectId.OTHER).sum() == 4
    with pytest.raises(InvalidValueError, match="groups"):
        SceneGeometry.from_model(model, groups=(5,))


def test_geom_without_a_surface_is_refused_by_name():
    xml = """
    <mujoco><asset><hfield name="h" nrow="3" ncol="3" size="1 1 1 0.1"/></asset>
      <worldbody><geom name="hills" type="hfield" hfield="h" group="1"/></worldbody></mujoco>"""
    with pytest.raises(InvalidValueError, match="hills"):
        SceneGeometry.from_model(mujoco.MjModel.from_xml_string(xml))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.zeros((3, 2))}, "shape of points"),
        ({"triangles": np.array([[0, 1, 3]])}, "triangles is"),
        ({"triangles": np.zeros((0, 3), dtype=int)}, "shape of triangles"),
        ({"points": np.full((3, 3), np.nan)}, "NaN"),
        ({"object_ids": 0}, "object_ids"),
        ({"object_ids": 9}, "object_ids"),
        ({"object_ids": np.array([1, 1])}, "shape of object_ids"),
        ({"albedo_factor": -1.0}, "albedo_factor"),
    ],
)
def test_bad_arrays_are_refused(change, message):
    with pytest.raises(InvalidValueError, match=message):
        SceneGeometry(**{**TRIANGLE, **change})


def test_points_can_be_moved_but_not_multiplied():
    scene = SceneGeometry(**TRIANGLE)
    scene.move(2.0 * np.eye(3))
    np.testing.assert_array_equal(scene.points, 2.0 * np.eye(3, dtype=np.float32))
    with pytest.raises(InvalidValueError, match="shape of points"):
        scene.move(np.zeros((4, 3)))


def test_pairs_complete_the_triangles_around_a_vertex():
    scene = SceneGeometry(points=np.eye(4)[:, :3], triangles=np.array([[0, 1, 2], [3, 2, 1]]), object_ids=ObjectId.TISSUE)
    offsets, pairs = scene.neighbours()
    assert [pairs[a:b].tolist() for a, b in pairwise(offsets)] == [[[1, 2]], [[2, 0], [3, 2]], [[0, 1], [1, 3]], [[2, 1]]]


SHEET = """
<mujoco>
  <worldbody>
    <flexcomp name="sheet" type="grid" count="21 21 1" spacing="0.005 0.005 0.005" dim="2" radius="0.0005" mass="0.1">
      <contact selfcollide="none"/>
      <edge equality="true"/>
    </flexcomp>
    <geom name="stage/plate" type="box" size="0.1 0.1 0.001" pos="0 0 -0.05" group="1"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def sheet():
    model = mujoco.MjSpec.from_string(SHEET).compile()
    model.flex_group[:] = 1
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_a_plain_appearance_leaves_the_scene_as_it_is(sheet):
    model, _ = sheet
    plain, same = (
        SceneGeometry.from_model(model, rng=np.random.default_rng(4), appearance=a) for a in (None, TissueAppearance())
    )
    np.testing.assert_array_equal(plain.albedo_factor, same.albedo_factor)


def test_patches_are_on_the_tissue_alone_and_move_with_it(sheet):
    model, data = sheet
    plain, bloody, again = (
        SceneGeometry.from_model(model, rng=np.random.default_rng(4), appearance=a)
        for a in (None, *2 * (TissueAppearance(coverage=0.2),))
    )
    np.testing.assert_array_equal(bloody.albedo_factor, again.albedo_factor)
    tissue = np.arange(len(plain.points)) < 21 * 21
    assert (bloody.albedo_factor[tissue] < 0.6 * plain.albedo_factor[tissue]).mean() == pytest.approx(0.15, abs=0.06)
    np.testing.assert_array_equal(bloody.albedo_factor[~tissue], 1.0)
    bloody.update(data)
    before, dark = bloody.points.copy(), bloody.albedo_factor.copy()
    moved = mujoco.MjData(model)
    moved.qpos[:] = data.qpos
    moved.qpos += 0.01
    mujoco.mj_forward(model, moved)
    bloody.update(moved)
    # Every vertex of the sheet has a body of its own that slides along three axes.
    np.testing.assert_allclose(bloody.points[tissue] - before[tissue], 0.01, atol=1e-6)
    np.testing.assert_array_equal(bloody.albedo_factor, dark)


def test_an_appearance_needs_something_to_be_drawn_from(sheet):
    with pytest.raises(InvalidValueError, match="rng"):
        SceneGeometry.from_model(sheet[0], appearance=TissueAppearance(coverage=0.1))


class Hill:
    """A tissue that no flex of the model knows of."""

    triangles = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    rest_points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, 0.1, 0.02], [0.0, 0.1, 0.0]])

    def __init__(self):
        self.shift = 0.0

    def surface_points(self):
        return self.rest_points + self.shift


def test_a_given_tissue_takes_the_place_of_the_models_flexes(sheet):
    model, data = sheet
    hill = Hill()
    scene = SceneGeometry.from_model(model, tissue=hill, rng=np.random.default_rng(4))
    is_tissue = scene.object_ids == ObjectId.TISSUE
    np.testing.assert_array_equal(scene.triangles[is_tissue], hill.triangles)
    texture = tissue_albedo(hill.rest_points, TissueAppearance(), np.random.default_rng(4))
    np.testing.assert_array_equal(scene.albedo_factor[:4], texture)
    hill.shift = 0.03
    scene.update(data)
    np.testing.assert_allclose(scene.points[:4], hill.rest_points + 0.03, atol=1e-8)
    # The plate of the model is still there, 50 mm below.
    assert scene.points[4:, 2].max() == pytest.approx(-0.049)
