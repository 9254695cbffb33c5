"""A theatre with another seed's phantom in it is the one that compiling would make; its lean mesh changes nothing."""

import mujoco
import numpy as np
import pytest

from laploop.assets.phantom import build_phantom
from laploop.assets.tissue_config import TissueConfig
from laploop.assets.tissue_mesh import TissueMesh, solid_from_tetrahedra, solid_mesh
from laploop.assets.tissue_shape import height_field
from laploop.envs.theatre import scene
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.scene_cache import BoundedCache
from laploop.envs.theatre.theatre import Theatre
from laploop.envs.theatre.theatre_model import arrays_of_phantom, compile_theatre, with_arrays, with_phantom

CONFIG = TissueConfig()


def grown(seed, every=1):
    height = height_field(CONFIG.shape, np.random.default_rng(seed))
    return solid_mesh(CONFIG.shape, height, CONFIG.cells, every), height


def saved(model):
    """Return a model as bytes."""
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer


@pytest.fixture(scope="module")
def plans():
    """Return what the theatres of two seeds are made from, whose tetrahedra are the same."""
    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene, "_TEMPLATES", BoundedCache(1))
        patch.setattr(scene, "with_phantom", lambda model, plan: found.append(plan) or with_phantom(model, plan))
        for seed in (3, 5):
            scene._kept_scene(TheatreConfig(), seed, 0.002, None)
    assert len(found[0].mesh.tetrahedra) == len(found[1].mesh.tetrahedra)
    return found


def test_another_seeds_phantom_makes_the_model_that_compiling_makes(plans):
    one, other = (compile_theatre(plan) for plan in plans)
    assert (saved(one) != saved(other)).any()
    np.testing.assert_array_equal(saved(with_phantom(one, plans[1])), saved(other))
    # Either is left as it was.
    np.testing.assert_array_equal(saved(with_arrays(one, arrays_of_phantom(other))), saved(other))
    np.testing.assert_array_equal(saved(one), saved(compile_theatre(plans[0])))


def test_the_solvers_unit_of_inertia_is_that_of_what_moves(plans):
    model = compile_theatre(plans[0])
    joints = [model.joint(f"tool_arm/instrument/contact_{axis}").dofadr[0] for axis in "xyz"]
    assert (model.dof_M0[joints] > 9_999.0).all()
    assert model.stat.meaninertia == pytest.approx(np.delete(model.dof_M0, joints).mean())
    assert model.stat.meaninertia < 1.0


def finest(height):
    """Return the same solid with every sample at the bottom, too: each prism of two triangles cut into three tetrahedra."""
    n = len(height)
    line = np.linspace(-0.06, 0.06, n)
    x, y = np.meshgrid(line, line, indexing="ij")
    points = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3) for z in (np.zeros_like(x), height)])
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    up = n * n
    tetrahedra = []
    for triangles in ((a, b, c), (a, c, d)):
        p, q, r = np.sort(np.stack(triangles), axis=0)
        tetrahedra += [np.column_stack(t) for t in ((p, q, r, r + up), (p, q, q + up, r + up), (p, p + up, q + up, r + up))]
    return solid_from_tetrahedra(points, np.concatenate(tetrahedra))


@pytest.mark.parametrize("seed", [3, 4])
def test_the_lean_mesh_has_the_mass_and_stiffness_of_the_finest(seed):
    mesh, height = grown(seed)
    fine = finest(height)
    assert len(mesh.points) < 0.7 * len(fine.points)
    lean, full = build_phantom(mesh, CONFIG).compile(), build_phantom(fine, CONFIG).compile()
    for name in ("flex_stiffness", "body_mass"):
        expected = getattr(full, name)
        np.testing.assert_allclose(getattr(lean, name), expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


def test_contacts_of_a_thinned_mesh_feel_every_other_sample_and_the_eye_sees_all():
    mesh, height = grown(3, every=2)
    whole, _ = grown(3)
    np.testing.assert_array_equal(mesh.surface_points, whole.surface_points)
    felt = mesh.points[mesh.points[:, 2] > 0.0]
    np.testing.assert_array_equal(felt[:, 2], height[::2, ::2].ravel())


def dome():
    """Return a cap of 100x100x25 mm in two layers of tetrahedra, whose inner one no contact needs."""
    rings, sectors, layers = 12, 24, 6
    angle = np.arange(sectors) * (2.0 * np.pi / sectors)
    points = []
    for layer in range(layers + 1):
        for ring in range(rings + 1):
            radius = 0.05 * ring / rings
            height = 0.004 + 0.021 * (1.0 - (ring / rings) ** 2)
            points += [[radius * np.cos(t), radius * np.sin(t), height * layer / layers] for t in angle]
    points = np.round(np.array(points), 9)
    from scipy.spatial import Delaunay

    unique = np.unique(points, axis=0)
    tetrahedra = Delaunay(unique).simplices
    corners = unique[tetrahedra]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    return solid_from_tetrahedra(unique, tetrahedra[volumes > 1e-13])


def test_a_users_solid_is_carried_by_its_outer_tetrahedra_with_the_mechanics_of_the_whole():
    solid = dome()
    assert len(solid.outer) < 0.7 * len(solid.tetrahedra)
    config = TheatreConfig(seed=0, working_distance_m=0.085)
    lean = Theatre(config, solid=solid)
    everything = TissueMesh(**{**vars(solid), "outer": np.arange(len(solid.tetrahedra), dtype=np.int32)})
    full = Theatre(config, solid=everything)
    assert lean.model.nflexelem < 0.7 * full.model.nflexelem
    for name in ("flex_stiffness", "body_mass", "dof_invweight0", "flex_size"):
        np.testing.assert_array_equal(getattr(lean.model, name), getattr(full.model, name))
    np.testing.assert_array_equal(lean.data.qpos, full.data.qpos)
    np.testing.assert_array_equal(lean.tissue.surface_points(), full.tissue.surface_points())
