"""Table, wall and stage compile alone and refuse trocars beside the wall."""

import mujoco
import numpy as np
import pytest

from laploop.assets.operating_table import STAGE_PLATE_SIDE_M, build_operating_table, build_stage
from laploop.errors import InvalidValueError

TROCARS = {"left": np.array([0.0, 0.0, 0.3]), "right": np.array([0.1, 0.0, 0.3])}


def test_trocar_sites_lie_in_the_wall():
    model = build_operating_table(wall_height_m=0.3, trocars=TROCARS).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, position in TROCARS.items():
        np.testing.assert_allclose(data.site(name).xpos, position, atol=1e-12)


def test_trocar_beside_the_wall_is_refused():
    with pytest.raises(InvalidValueError, match="trocar 'left'"):
        build_operating_table(wall_height_m=0.31, trocars=TROCARS)


def test_stage_moves_as_prescribed():
    model = build_stage().compile()
    data = mujoco.MjData(model)
    data.mocap_pos[0] = [0.0, 0.0, 0.05]
    mujoco.mj_kinematics(model, data)
    np.testing.assert_array_equal(data.body("plate").xpos, [0.0, 0.0, 0.05])
    assert model.geom_size[0, 0] == 0.5 * STAGE_PLATE_SIDE_M
