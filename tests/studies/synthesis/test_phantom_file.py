"""Organs as phantoms: one closed body within the limits of a user's mesh, which a theatre carries at rest."""

import numpy as np
import pytest

from laploop.assets.anatomy.phantom_body import PHANTOMS, phantom_body
from laploop.assets.phantom_import.phantom_mesh import MAX_TRIANGLES, checked_surface
from laploop.assets.tissue_config import TissueConfig
from laploop.envs.theatre.config import TheatreConfig
from laploop.envs.theatre.theatre import Theatre
from laploop.errors import InvalidValueError, UnknownNameError
from laploop.studies.synthesis.phantom_file import write_phantom


@pytest.mark.parametrize("family", PHANTOMS)
def test_body_passes_the_checks_of_a_users_mesh(family, tmp_path):
    body = write_phantom(family, 2, tmp_path / "organ.stl")
    # Raises if it is open, in several pieces, crosses itself or is too large.
    points, triangles = checked_surface(tmp_path / "organ.stl")
    assert len(triangles) == len(body.triangles) <= MAX_TRIANGLES
    np.testing.assert_allclose(np.ptp(points, axis=0), 1e3 * np.ptp(body.points, axis=0), atol=1e-3)
    assert body.points[:, 2].min() == 0.0


def test_seed_decides_the_body():
    one, same, other = (phantom_body("lobes", np.random.default_rng(seed)).points for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert one.shape != other.shape or not np.allclose(one, other)


def test_unknown_family_and_suffix_are_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="bowel-loops, lobes, sacs, stomach"):
        write_phantom("liver", 0, tmp_path / "organ.stl")
    with pytest.raises(InvalidValueError, match=r"'.step'; allowed: .stl or .obj or .ply"):
        write_phantom("lobes", 0, tmp_path / "organ.step")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("family", PHANTOMS)
def test_theatre_with_it_comes_to_rest(family, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_phantom(family, 1, tmp_path / "organ.stl")
    theatre = Theatre(TheatreConfig(seed=0, working_distance_m=0.085, tissue=TissueConfig(mesh=tmp_path / "organ.stl")))
    for _ in range(500):
        theatre.step()
    assert np.abs(theatre.data.qvel).max() < 1e-4  # m/s
