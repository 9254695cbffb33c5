import mujoco
import numpy as np
import pytest

from laploop.envs.sensors.optics.tissue_appearance import (
    AppearanceRanges,
    TissueAppearance,
    appearance_factor,
    draw_appearance,
)
from laploop.envs.sensors.tracing.scene_geometry import SceneGeometry
from laploop.errors import InvalidValueError

POINTS = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 101), np.linspace(-0.1, 0.1, 101), [0.0]), axis=-1).reshape(-1, 3)
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


@pytest.mark.parametrize("coverage", [0.05, 0.2, 0.5])
def test_patches_cover_what_they_should_and_are_as_dark_as_said(coverage):
    appearance = TissueAppearance(coverage=coverage, darkness=0.7)
    factor = appearance_factor(POINTS, appearance, np.random.default_rng(1))
    # Half-way up its soft border a patch has taken half of its darkness.
    assert (factor < 1.0 - 0.5 * 0.7).mean() == pytest.approx(coverage, abs=0.003)
    assert factor.min() == pytest.approx(0.3, abs=1e-5)
    assert factor.max() == 1.0


def test_patches_have_their_size():
    areas = []
    for size in (0.008, 0.016):
        factor = appearance_factor(POINTS, TissueAppearance(coverage=0.15, patch_size_m=size), np.random.default_rng(2))
        dark = factor.reshape(101, 101) < 0.7
        borders = (dark[1:] != dark[:-1]).sum() + (dark[:, 1:] != dark[:, :-1]).sum()
        areas.append(dark.sum() / borders)
    # Area over outline grows as the size does.
    assert areas[1] / areas[0] == pytest.approx(2.0, rel=0.35)


def test_darker_patches_stay_where_they_are():
    factors = [
        appearance_factor(POINTS, TissueAppearance(coverage=0.1, darkness=d), np.random.default_rng(3)) for d in (0.3, 0.6)
    ]
    np.testing.assert_allclose((1.0 - factors[1]) / 0.6, (1.0 - factors[0]) / 0.3, atol=1e-5)


def test_detail_varies_the_albedo_by_what_was_said():
    factor = appearance_factor(POINTS, TissueAppearance(detail=0.1), np.random.default_rng(5))
    assert factor.std() == pytest.approx(0.1, rel=0.15)
    assert factor.mean() == pytest.approx(1.0, abs=0.01)


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


def test_appearances_are_drawn_from_their_ranges():
    ranges = AppearanceRanges()
    draws = [draw_appearance(np.random.default_rng(seed)) for seed in range(60)]
    assert draws[2] == draw_appearance(np.random.default_rng(2), ranges)
    for name in ("coverage", "darkness", "patch_size_m", "detail"):
        low, high = getattr(ranges, name)
        values = [getattr(draw, name) for draw in draws]
        assert low <= min(values) < max(values) <= high
        assert max(values) - min(values) > 0.8 * (high - low)
    with pytest.raises(InvalidValueError, match="darkness"):
        AppearanceRanges(darkness=(0.8, 0.3))


@pytest.mark.parametrize(("field", "value"), [("coverage", 1.0), ("darkness", -0.1), ("patch_size_m", 0.0), ("detail", 1.0)])
def test_impossible_appearances_are_refused_by_name(field, value):
    with pytest.raises(InvalidValueError, match=field):
        TissueAppearance(**{field: value})


def test_an_appearance_needs_something_to_be_drawn_from(sheet):
    with pytest.raises(InvalidValueError, match="rng"):
        SceneGeometry.from_model(sheet[0], appearance=TissueAppearance(coverage=0.1))
