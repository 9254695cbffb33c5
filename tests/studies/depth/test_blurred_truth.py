import json

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.data.frame_store import FrameStore
from laploop.studies.depth.blurred_truth import blurred, main
from laploop.studies.readme.anatomy_tables import blur_table


@pytest.fixture
def step(tmp_path):
    """A frame with a step of 20 mm down its middle, without truth in a corner, and a frame out of range."""
    path = tmp_path / "frames" / "frames.zarr"
    path.parent.mkdir()
    store = FrameStore.create(
        path,
        optics=ScopeOptics(),
        tissue_seed=np.arange(2),
        split=np.full(2, 2, np.uint8),
        tool_in_view=np.zeros(2, bool),
        config={},
    )
    depth = np.where(np.arange(256) < 128, 80.0, 100.0) * np.ones((256, 1))
    depth[:8, :8] = np.nan
    for index, values in enumerate((depth, np.full((256, 256), 200.0))):
        store.write(
            index, image=np.zeros((256, 256), np.uint8), depth_mm=values.astype(np.float32), lit=np.ones((256, 256), bool)
        )
    return path


def test_blur_leaves_planes_and_ignores_what_is_not_known():
    y, x = np.mgrid[:64, :64]
    plane = 90.0 + 0.3 * x - 0.1 * y
    plane[30, 30] = np.nan
    found = blurred(plane, 2.0)
    assert np.isnan(found[30, 30])
    inner = np.isfinite(plane[10:-10, 10:-10])
    np.testing.assert_allclose(found[10:-10, 10:-10][inner], plane[10:-10, 10:-10][inner], atol=0.02)


def test_a_step_costs_its_height_times_the_mean_tail_of_the_gaussian(step, tmp_path):
    main([str(tmp_path / "blur.json"), str(step)])
    written = json.loads((tmp_path / "blur.json").read_text())
    found = written["sets"]["frames"]
    assert found["frames"] == 2
    # The tail of a Gaussian beyond a step, integrated over both sides, is 2 sigma / sqrt(2 pi); narrow ones meet few pixels.
    expected = 20.0 * 2.0 / np.sqrt(2.0 * np.pi) / 256 * np.array(written["sigma_px"])
    np.testing.assert_allclose(found["mae_mm"][2:], expected[2:], rtol=0.04)
    table = blur_table(written)
    assert "12.8 pixels" in table
    assert table.splitlines()[-1].startswith("| held-out tissues | 2 | ")


def test_frames_without_a_pixel_in_range_are_refused(tmp_path):
    store = FrameStore.create(
        tmp_path / "far",
        optics=ScopeOptics(),
        tissue_seed=np.arange(1),
        split=np.full(1, 2, np.uint8),
        tool_in_view=np.zeros(1, bool),
        config={},
    )
    far = np.full((256, 256), 200.0, np.float32)
    store.write(0, image=np.zeros((256, 256), np.uint8), depth_mm=far, lit=np.ones((256, 256), bool))
    with pytest.raises(InvalidValueError, match="1 or more in the working range"):
        main([str(tmp_path / "blur.json"), str(tmp_path / "far")])
    assert not (tmp_path / "blur.json").exists()
