"""The phantom is pinned at its bottom, stands up under its weight, and gives way where it should."""

import mujoco
import numpy as np
import pytest

from laploop.assets.phantom import TISSUE, build_phantom
from laploop.assets.tissue_config import TissueConfig, TissueMaterial
from laploop.assets.tissue_mesh import solid_mesh
from laploop.assets.tissue_shape import height_field

CONFIG = TissueConfig()


def phantom(seed=0, config=CONFIG):
    mesh = solid_mesh(config.shape, height_field(config.shape, np.random.default_rng(seed)))
    model = build_phantom(mesh, config).compile()
    return mesh, model, mujoco.MjData(model)


def test_exactly_the_bottom_nodes_of_the_lattice_are_pinned():
    _, model, data = phantom()
    mujoco.mj_forward(model, data)
    nx, ny, nz = CONFIG.nodes
    bodies = model.flex_nodebodyid
    assert bodies.size == nx * ny * nz
    free = bodies[model.body_dofnum[bodies] > 0]
    assert np.all(model.body_dofnum[free] == 3)
    assert free.size == nx * ny * (nz - 1)
    # Metres: the free nodes are the upper layer, at the height of the highest point.
    np.testing.assert_allclose(data.xpos[free, 2], data.xpos[free, 2].max(), atol=1e-9)
    assert data.xpos[free, 2].max() > 0.02


def test_vertices_start_where_the_mesh_has_them():
    mesh, model, data = phantom()
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.flexvert_xpos, mesh.points, atol=1e-7)


def test_mass_is_volume_times_density():
    mesh, model, _ = phantom()
    corners = mesh.points[mesh.tetrahedra]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1]).sum() / 6.0
    # Pinned nodes carry their share, too; MuJoCo raises tiny masses a little.
    np.testing.assert_allclose(model.body_mass.sum(), volume * CONFIG.material.density, rtol=1e-3)


@pytest.mark.parametrize("seed", [0, 15, 17])
def test_tissue_comes_to_rest_and_hardly_sags(seed):
    mesh, model, data = phantom(seed)
    for _ in range(300):
        mujoco.mj_step(model, data)
    # m/s: slower than any sensor could see.
    assert np.abs(data.qvel).max() < 1e-6
    mujoco.mj_forward(model, data)
    assert np.abs(data.flexvert_xpos - mesh.points).max() < 0.001
    assert not data.warning.number.any()


def test_twice_the_stiffness_halves_the_sag():
    sags = []
    for young in (10_000.0, 20_000.0):
        mesh, model, data = phantom(config=TissueConfig(material=TissueMaterial(young_pa=young)))
        for _ in range(400):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        sags.append(np.abs(data.flexvert_xpos - mesh.points).max())
    # Linear elasticity in small strain.
    np.testing.assert_allclose(sags[0] / sags[1], 2.0, rtol=0.05)


def test_flex_has_its_name_and_keeps_to_itself():
    _, model, _ = phantom()
    assert mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, TISSUE) == 0
    assert model.flex_selfcollide[0] == 0
