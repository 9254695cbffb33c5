"""A user's closed surface becomes a solid like the built-in one; anything else is refused with the reason."""

import builtins
from pathlib import Path

import numpy as np
import pytest
import trimesh

from laploop.assets.phantom_import import phantom_mesh
from laploop.assets.phantom_import.phantom_mesh import checked_surface, load_phantom
from laploop.assets.tissue_mesh import mean_top_height
from laploop.errors import InvalidValueError, LaploopNote, MissingFileError


def box(x=60.0, y=50.0, z=20.0, at=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation(at)
    return mesh


def saved(mesh, folder, suffix="stl"):
    path = folder / f"body.{suffix}"
    mesh.export(path)
    return path


def dome():
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.vertices[:, 2] = np.maximum(mesh.vertices[:, 2], 0.0)
    # The lower half, pressed flat, is the underside.
    mesh.apply_scale((40.0, 40.0, 25.0))
    return mesh


def load_anew(path):
    """Load a phantom as a new process does."""
    phantom_mesh._loaded.cache_clear()
    return load_phantom(path)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def solid(cache, tmp_path_factory):
    mesh = dome()
    mesh.apply_translation((10.0, -20.0, 300.0))
    return load_phantom(saved(mesh, tmp_path_factory.mktemp("dome")))


def test_solid_is_centred_on_the_plate_in_metres(solid):
    low, high = solid.points.min(axis=0), solid.points.max(axis=0)
    # Metres: the mesher keeps to within a thousandth of the diagonal, 0.12 mm.
    np.testing.assert_allclose(low, [-0.040, -0.040, 0.0], atol=2e-4)
    np.testing.assert_allclose(high, [0.040, 0.040, 0.025], atol=4e-4)
    np.testing.assert_allclose(low[:2], -high[:2], atol=1e-12)


def test_tetrahedra_are_positive_and_fill_the_body(solid):
    corners = solid.points[solid.tetrahedra]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    assert volumes.min() > 0.0
    # A tenth of a millimetre of skin over an 80 mm dome.
    np.testing.assert_allclose(volumes.sum(), dome().volume * 1e-9, rtol=0.01)


def test_visible_surface_is_the_dome_turned_outwards(solid):
    points = solid.surface_points
    corners = points[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    middles = corners.mean(axis=1)
    exact = middles / np.array([0.040, 0.040, 0.025]) ** 2
    cosine = np.sum(normals * exact, axis=1) / np.linalg.norm(normals, axis=1) / np.linalg.norm(exact, axis=1)
    high = middles[:, 2] > 0.005
    # Facets of 3 mm on a dome of 80 mm, above its sharp rim.
    assert np.degrees(np.arccos(cosine[high].min())) < 12.0
    assert high.mean() > 0.5


def test_top_comes_first_and_its_mean_height_is_that_of_the_half_ellipsoid(solid):
    top = solid.triangles[: solid.top_triangle_count]
    assert np.unique(top).size == top.max() + 1
    assert np.unique(solid.triangles).size == len(solid.surface_points)
    # Two thirds of the height; metres.
    assert mean_top_height(solid) == pytest.approx(2.0 / 3.0 * 0.025, abs=3e-4)


def test_mesher_leaves_nothing_behind_and_its_failure_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    path = saved(box(30.0, 30.0, 12.0), tmp_path)
    monkeypatch.setattr(phantom_mesh, "_EDGE_FRACTION", 0.1)
    load_anew(path)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["body.stl", "cache"]
    monkeypatch.setattr(phantom_mesh, "_EDGE_FRACTION", -1.0)
    with pytest.raises(InvalidValueError, match=r"phantom body\.stl is 'ValueError.*allowed: a body that fTetWild can fill"):
        load_anew(path)


def test_file_is_read_again_only_when_it_has_changed(tmp_path, monkeypatch):
    def fill(_path, points, triangles, _settings):
        points = np.concatenate([points, [points.mean(axis=0)]])
        return points, np.column_stack([triangles, np.full(len(triangles), len(points) - 1)]).astype(np.int32)

    monkeypatch.setattr(phantom_mesh, "_fill", fill)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    path = saved(box(), tmp_path)
    first = load_anew(path)
    assert load_phantom(path) is first
    saved(box(x=61.0).subdivide(), tmp_path)
    assert load_phantom(path) is not first
    with pytest.raises(ValueError, match="read-only"):
        first.points[0] = 0.0


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_every_format_gives_the_same_surface(tmp_path, suffix):
    points, triangles = checked_surface(saved(dome(), tmp_path, suffix))
    assert len(triangles) == len(dome().faces)
    np.testing.assert_allclose(np.ptp(points, axis=0), [80.0, 80.0, 25.0], rtol=1e-5)


def test_surface_turned_inside_out_is_turned_back(tmp_path):
    mesh = box()
    mesh.invert()
    points, triangles = checked_surface(saved(mesh, tmp_path, "ply"))
    assert np.linalg.det(points[triangles]).sum() > 0.0


def open_box():
    mesh = box()
    mesh.update_faces(np.arange(len(mesh.faces)) != 3)
    return mesh


def mixed_box():
    mesh = box()
    mesh.faces[2] = mesh.faces[2][::-1]
    return mesh


def spiked_box():
    mesh = box().subdivide()
    # One vertex of the bottom pulled out through the top.
    low = np.flatnonzero(np.isclose(mesh.vertices[:, 2], -10.0) & (np.abs(mesh.vertices[:, :2]) < 1.0).all(axis=1))
    mesh.vertices[low, 2] = 15.0
    return mesh


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (open_box, "open or overcrowded edges of phantom body.ply is 3; allowed: 0"),
        (mixed_box, "orientation of phantom body.ply is 'mixed'"),
        (spiked_box, "self-intersecting near"),
        (lambda: trimesh.util.concatenate([box(), box(at=(70.0, 0.0, 0.0))]), "separate surfaces of phantom body.ply is 2"),
        (lambda: box(x=0.06, y=0.05, z=0.02), "size of phantom body.ply along x is '0.06 mm'; allowed: 20 to 200 mm"),
        (lambda: box(y=201.0), "along y is '201 mm'"),
        (lambda: box(z=81.0), "along z is '81 mm'; allowed: 5 to 80 mm"),
    ],
)
def test_unfit_surface_is_refused_with_the_reason(tmp_path, make, message):
    with pytest.raises(InvalidValueError, match=message.replace("(", r"\(")):
        checked_surface(saved(make(), tmp_path, "ply"))


def test_far_too_many_triangles_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(phantom_mesh, "MAX_GIVEN_TRIANGLES", 100)
    with pytest.raises(
        InvalidValueError, match=r"number of triangles of phantom body\.stl is 1280; allowed: 4 to 100; simplify"
    ):
        checked_surface(saved(dome(), tmp_path))


def test_too_fine_a_surface_is_simplified_and_the_user_told(tmp_path, monkeypatch):
    monkeypatch.setattr(phantom_mesh, "MAX_TRIANGLES", 5000)
    mesh = dome().subdivide().subdivide()
    said = r"phantom body\.stl was simplified from 20480 to 5000 triangles, at most 0\.0\d+ mm away"
    with pytest.warns(LaploopNote, match=said):
        points, triangles = checked_surface(saved(mesh, tmp_path))
    assert len(triangles) == 5000
    # As any other surface: closed and turned outwards; it encloses what the given one did.
    simpler = trimesh.Trimesh(points, triangles, process=False)
    assert simpler.is_watertight
    assert simpler.volume == pytest.approx(mesh.volume, rel=1e-3)


def test_what_simplifying_would_change_too_much_is_refused(tmp_path, monkeypatch):
    # Few triangles for a round dome.
    monkeypatch.setattr(phantom_mesh, "MAX_TRIANGLES", 80)
    message = r"distance of phantom body\.stl from itself with 80 triangles is '\S+ mm'; allowed: at most 0\.12 mm"
    with pytest.raises(InvalidValueError, match=message):
        checked_surface(saved(dome(), tmp_path))
    monkeypatch.setattr(phantom_mesh, "MAX_TRIANGLES", 40)
    with pytest.raises(InvalidValueError, match=r"triangles of simplified phantom body\.stl is \d+; allowed: at most 40"):
        checked_surface(saved(dome(), tmp_path))


def test_a_simplified_surface_is_checked_like_any_other(tmp_path, monkeypatch):
    monkeypatch.setattr(phantom_mesh, "MAX_TRIANGLES", 100)
    monkeypatch.setattr(phantom_mesh, "_simplified", lambda _name, _surface: spiked_box())
    with pytest.raises(InvalidValueError, match=r"simplified phantom body\.stl is 'self-intersecting near"):
        checked_surface(saved(dome(), tmp_path))
    monkeypatch.setattr(phantom_mesh, "_simplified", lambda _name, _surface: open_box())
    with pytest.raises(InvalidValueError, match=r"edges of simplified phantom body\.stl is 3"):
        checked_surface(saved(dome(), tmp_path))


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.stl", b""), ("b.ply", b"not a mesh"), ("c.obj", b"\xff\xfe\x00"), ("d.stl", b"solid\n"), ("e.obj", b"v 0 0 0\n")],
)
def test_unreadable_or_empty_file_is_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InvalidValueError, match=name):
        checked_surface(tmp_path / name)


def damaged(good, rng):
    """Return the bytes of a file cut short, with some bytes changed, without its head, and junk."""
    flipped = bytearray(good)
    for place in rng.integers(len(good), size=20):
        flipped[place] = rng.integers(256)
    return good[: rng.integers(len(good))], bytes(flipped), rng.bytes(84) + good[84:], rng.bytes(int(rng.integers(5000)))


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply"])
def test_damaged_files_are_refused_in_one_line(tmp_path, suffix):
    good = saved(dome(), tmp_path, suffix).read_bytes()
    rng = np.random.default_rng(0)
    messages = []
    for content in (content for _ in range(8) for content in damaged(good, rng)):
        path = tmp_path / f"damaged.{suffix}"
        path.write_bytes(content)
        try:
            points, _ = checked_surface(path)
        except InvalidValueError as error:
            messages.append(str(error))
        else:
            # What passes, such as a changed digit, is still a surface of sensible size.
            assert np.ptp(points, axis=0).max() <= 200.0
    assert len(messages) >= 24
    assert all("\n" not in message and len(message) < 300 for message in messages)


def test_missing_file_unknown_suffix_and_folder_are_refused(tmp_path):
    with pytest.raises(MissingFileError, match=r"none\.stl"):
        checked_surface(tmp_path / "none.stl")
    with pytest.raises(InvalidValueError, match=r"\.step.*allowed: \.stl or \.obj or \.ply"):
        checked_surface(tmp_path / "part.step")
    (tmp_path / "folder.ply").mkdir()
    for path in (tmp_path / "folder.ply", tmp_path / ("x" * 300 + ".ply"), Path("~nosuchuser/a.ply"), Path("a\0b.ply")):
        with pytest.raises(MissingFileError):
            load_phantom(path)


def test_file_of_gigabytes_is_refused_unread(tmp_path):
    with (tmp_path / "huge.stl").open("wb") as stream:
        stream.truncate(2 * 2**30)
    with pytest.raises(InvalidValueError, match=r"size of .*huge\.stl is '2147483648 bytes'; allowed: at most 104857600"):
        load_phantom(tmp_path / "huge.stl")


@pytest.mark.parametrize("package", ["pytetwild", "fast_simplification"])
def test_missing_extra_is_named_with_the_way_to_get_it(tmp_path, monkeypatch, package):
    real = builtins.__import__

    def without_mesher(name, *args, **kwargs):
        if name == package:
            raise ModuleNotFoundError(f"No module named '{package}'", name=package)
        return real(name, *args, **kwargs)

    path = saved(box(), tmp_path)
    monkeypatch.setattr(builtins, "__import__", without_mesher)
    with pytest.raises(InvalidValueError, match=rf"{package}.*pip install 'laploop\[mesh\]'"):
        checked_surface(path)
