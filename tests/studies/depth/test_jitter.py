import csv

import numpy as np
import pytest

from laploop.assets.scope_optics import ScopeOptics
from laploop.errors import InvalidValueError
from laploop.perception.estimators import ESTIMATORS
from laploop.perception.messages import DepthEstimate
from laploop.studies.depth.config import RobustnessConfig
from laploop.studies.depth.jitter import measure_jitter, still_scenes, write_jitter

TINY = RobustnessConfig(tissues=2, frames_per_tissue=1, seed=3, noise_seeds=4)


class Alternating:
    """Sees 100 mm and 102 mm by turns; every other time it also marks the upper half valid."""

    def __init__(self, rig):
        self.calls, self.size = 0, (rig.camera.height, rig.camera.width)

    def estimate(self, image):
        self.calls += 1
        odd = self.calls % 2
        valid = np.ones(self.size, bool)
        valid[: self.size[0] // 2] = bool(odd)
        return DepthEstimate(depth_mm=np.full(self.size, 100.0 + 2.0 * odd, np.float32), valid=valid)


@pytest.fixture
def alternating():
    ESTIMATORS.register("alternating", Alternating)
    yield "alternating"
    ESTIMATORS.unregister("alternating")


def test_images_of_a_still_scene_differ_in_their_noise_alone():
    scenes, again = (list(still_scenes(TINY, ScopeOptics())) for _ in range(2))
    assert len(scenes) == 2
    for scene, same in zip(scenes, again, strict=True):
        assert len(scene.images) == 4
        for image, other in zip(scene.images, same.images, strict=True):
            np.testing.assert_array_equal(image, other)
        difference = scene.images[0].astype(int) - scene.images[1]
        assert 0.2 < difference.std() < 6.0  # grey values
        assert abs(difference.mean()) < 0.05
    assert not np.array_equal(scenes[0].depth_mm, scenes[1].depth_mm)


def test_jitter_is_the_deviation_over_the_images(alternating, tmp_path):
    made, oracle, phase = rows = measure_jitter([alternating, "oracle", "phase"], ScopeOptics(), config=TINY, progress=False)
    deviation = 2.0 / np.sqrt(3.0)  # two of 100, two of 102 mm
    assert made.jitter_mm == pytest.approx(deviation)
    assert (made.jitter_median_mm, made.jitter_p95_mm) == pytest.approx((deviation, deviation))
    assert 0.2 < made.flicker_fraction < 0.8
    assert (oracle.jitter_mm, oracle.flicker_fraction) == (0.0, 0.0)
    assert 0.02 < phase.jitter_median_mm < 0.5
    assert phase.jitter_median_mm < phase.jitter_p95_mm
    write_jitter(rows, tmp_path)
    lines = list(csv.DictReader((tmp_path / "jitter.csv").read_text().splitlines()))
    assert [line["model"] for line in lines] == [alternating, "oracle", "phase"]
    assert float(lines[0]["jitter_mm"]) == made.jitter_mm
    assert "| oracle | 2 | 4 | 0.000 |" in (tmp_path / "jitter.md").read_text()


def test_a_measurement_of_nothing_is_refused():
    with pytest.raises(InvalidValueError, match="one name or more"):
        measure_jitter([], ScopeOptics(), config=TINY)
