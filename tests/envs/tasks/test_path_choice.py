from types import SimpleNamespace

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.envs.sensors.object_id import ObjectId
from laploop.envs.tasks.path_choice import PathChoiceConfig, choose_path_pixels, evenly, path_length_m
from laploop.errors import InvalidValueError, SimulationError
from laploop.perception.geometry import Rig

CAMERA = Rig.from_optics(ScopeOptics()).camera
SIZE = (CAMERA.height, CAMERA.width)
TROCAR = np.array([0.12, 0.0, -0.02])


def view(depth_mm, lit=None):
    """Stand in for a capture of tissue alone that faces the camera."""
    return SimpleNamespace(
        depth_mm=np.broadcast_to(np.asarray(depth_mm, np.float32), SIZE),
        normals=np.broadcast_to(np.array([0.0, 0.0, -1.0], np.float32), (*SIZE, 3)),
        object_id=np.full(SIZE, ObjectId.TISSUE, np.uint8),
        lit=np.ones(SIZE, bool) if lit is None else lit,
    )


def test_a_path_on_a_plane_has_its_length_and_even_steps():
    plane = view(90.0)
    path = choose_path_pixels(plane, CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())
    assert path.shape == (31, 2)
    # On a plane across the axis a pixel is 90 mm / f.
    steps_mm = np.linalg.norm(np.diff(path, axis=0), axis=1) * 90.0 / CAMERA.fx
    np.testing.assert_allclose(steps_mm.sum(), 60.0, atol=0.1)
    np.testing.assert_allclose(steps_mm, 2.0, atol=0.05)
    radius_mm = np.linalg.norm(path - [CAMERA.cx, CAMERA.cy], axis=1) * 90.0 / CAMERA.fx
    assert radius_mm.max() < 40.5


def test_a_path_turns_no_faster_than_it_may():
    config = PathChoiceConfig(max_turn_rad=0.1)
    path = choose_path_pixels(view(90.0), CAMERA, TROCAR, np.random.default_rng(1), config)
    heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
    # Even spacing cuts corners, so that a turn may fall into one step of the result: never more than the walk's.
    assert np.abs(np.diff(heading)).max() < 0.1 + 0.02


def test_a_path_keeps_to_high_ground():
    # A ridge along the image's diagonal, 6 mm above the valleys.
    across = (CAMERA.rays[..., 0] - CAMERA.rays[..., 1]) / np.sqrt(2.0)
    ridge = view(90.0 + 6.0 * np.minimum((across / 0.15) ** 2, 1.0))
    paths = [
        choose_path_pixels(ridge, CAMERA, TROCAR, np.random.default_rng(seed), PathChoiceConfig(max_turn_rad=0.4))
        for seed in range(5)
    ]
    ends = [across[int(path[-1, 1]), int(path[-1, 0])] for path in paths]
    assert np.median(np.abs(ends)) < 0.05


def test_a_path_leaves_out_what_is_not_lit():
    lit = np.ones(SIZE, bool)
    lit[:, :100] = False
    for seed in range(3):
        path = choose_path_pixels(view(90.0, lit), CAMERA, TROCAR, np.random.default_rng(seed), PathChoiceConfig())
        assert path[:, 0].min() >= 99.0


def test_of_several_lines_the_least_steep_is_taken():
    # Tissue that leans by 35 degrees left of the middle, which still qualifies, and faces the camera right of it.
    capture = view(90.0)
    lean = np.deg2rad(35.0)
    capture.normals = capture.normals.copy()
    capture.normals[:, :128] = [np.sin(lean), 0.0, -np.cos(lean)]

    def lines_on_the_flank(candidates):
        config = PathChoiceConfig(candidates=candidates)
        return sum(
            choose_path_pixels(capture, CAMERA, TROCAR, np.random.default_rng(seed), config)[:, 0].min() < 126.0
            for seed in range(8)
        )

    assert lines_on_the_flank(8) < lines_on_the_flank(1)


def test_the_same_seed_draws_the_same_path_and_another_one_another():
    paths = [
        choose_path_pixels(view(90.0), CAMERA, TROCAR, np.random.default_rng(seed), PathChoiceConfig()) for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(paths[0], paths[1])
    assert not np.array_equal(paths[0], paths[2])


def test_where_no_path_fits_the_error_says_so():
    with pytest.raises(SimulationError, match="no line of 60 mm"):
        choose_path_pixels(view(90.0, np.zeros(SIZE, bool)), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())


def strip_of(length_mm, width_mm=8.0):
    """Light a strip of a plane at 90 mm, along the image's rows, in the middle of the view."""
    half = 0.5 * CAMERA.fx / 90.0 * np.array([width_mm, length_mm])
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    return (np.abs(rows - CAMERA.cy) < half[0]) & (np.abs(columns - CAMERA.cx) < half[1])


def test_where_no_whole_line_fits_the_longest_is_led_from_end_to_end():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        path = choose_path_pixels(view(90.0, strip_of(45.0)), CAMERA, TROCAR, rng, PathChoiceConfig())
        assert path.shape == (31, 2)
        along_mm = np.linalg.norm(np.diff(path, axis=0), axis=1).sum() * 90.0 / CAMERA.fx
        # A step of 2 mm may be missing at either end, and a walk across the strip adds a little.
        assert 41.0 < along_mm < 49.0
        heading = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
        assert np.abs(np.diff(heading)).max() < PathChoiceConfig().max_turn_rad + 0.02  # where the two walks meet, too


def test_a_line_ends_where_the_shaft_would_touch():
    # From 25 mm right of the axis on, unlit tissue beside the strip is 12 mm higher: in the way of a shaft from the right.
    lit = strip_of(55.0)
    depth = np.where((CAMERA.rays[..., 0] * 90.0 > 25.0) & ~lit, 78.0, 90.0)
    path = choose_path_pixels(view(depth, lit), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())
    whole = choose_path_pixels(view(90.0, lit), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())
    assert path[:, 0].max() < whole[:, 0].max() - 2.0


@pytest.mark.parametrize(("length_mm", "min_share"), [(25.0, 0.5), (45.0, 1.0)])
def test_a_line_is_not_shorter_than_its_least_share(length_mm, min_share):
    with pytest.raises(SimulationError, match=f"no line of 60 mm .* nor one of {60 * min_share:.0f} mm"):
        choose_path_pixels(
            view(90.0, strip_of(length_mm)), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig(min_share=min_share)
        )


def test_a_path_keeps_off_the_near_end_of_the_working_range():
    with pytest.raises(SimulationError, match="0 pixels"):
        choose_path_pixels(view(61.5), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())
    choose_path_pixels(view(62.5), CAMERA, TROCAR, np.random.default_rng(0), PathChoiceConfig())


def test_even_spacing_counts_length_on_the_surface():
    # A step of 10 mm in depth in the middle of the image is part of the way.
    depth_m = np.full(SIZE, 0.09)
    depth_m[:, 128:] = 0.10
    path = np.stack([np.linspace(60.5, 195.5, 136), np.full(136, 128.5)], axis=-1)
    along = path_length_m(path, depth_m, CAMERA)
    assert np.diff(along).max() == pytest.approx(0.0100, abs=1e-4)
    even = evenly(path, depth_m, CAMERA, 20)
    np.testing.assert_allclose(np.interp(even[:, 0], path[:, 0], along), np.linspace(0.0, along[-1], 20), atol=1e-9)


@pytest.mark.parametrize(
    "changes", [{"length_m": 1.0}, {"spacing_m": 0.02}, {"max_turn_rad": 2.0}, {"candidates": 0}, {"min_share": 0.0}]
)
def test_impossible_paths_are_refused(changes):
    with pytest.raises(InvalidValueError, match=next(iter(changes))):
        PathChoiceConfig(**changes)
