import mujoco
import numpy as np

from laploop.assets.instrument import TIP, TIP_CONTACT, VISIBLE_GROUP, build_instrument
from laploop.assets.laparoscope import SHAFT_TIP, build_laparoscope
from laploop.assets.shafts import INSTRUMENT


def compiled(spec):
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def test_ball_end_is_centred_on_the_shaft_frame():
    model, data = compiled(build_instrument())
    tip = model.geom(TIP)
    np.testing.assert_allclose(data.site(SHAFT_TIP).xpos, [0.0, 0.0, INSTRUMENT.length_m], atol=1e-15)
    # A capsule along the shaft: the centre of its distal cap is half a length from its middle.
    cap = data.geom(TIP).xpos[2] + tip.size[1]
    np.testing.assert_allclose(cap, INSTRUMENT.length_m, atol=1e-12)
    assert tip.size[0] == INSTRUMENT.tip_radius_m


def test_taper_joins_the_shaft_to_the_neck():
    model, _ = compiled(build_instrument())
    vertices = model.mesh_vert[: model.mesh_vertnum[0]]
    radii = np.hypot(vertices[:, 0], vertices[:, 1])
    # Single precision of the mesh's vertices.
    np.testing.assert_allclose(radii.max(), 0.5 * INSTRUMENT.diameter_m, atol=1e-8)
    assert (model.geom_group[model.geom("taper").id]) == VISIBLE_GROUP


def test_only_tip_and_distal_shaft_can_touch_tissue():
    model, _ = compiled(build_instrument())
    touching = {model.geom(index).name for index in range(model.ngeom) if model.geom_conaffinity[index] & 1}
    assert touching == {TIP_CONTACT, "distal_shaft_contact"}


def test_tools_weigh_less_than_half_the_payload():
    for build in (build_laparoscope, build_instrument):
        model, _ = compiled(build())
        # 5 kg is the UR5's payload.
        assert 0.05 < model.body_mass.sum() < 2.5
