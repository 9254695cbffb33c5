"""The configurations of control: complete at the field, light to import, the same tree as in a file."""

import dataclasses
import subprocess
import sys
from dataclasses import replace

import pytest

from laploop.configuration import field_docs, from_plain, to_plain
from laploop.control.arm.rcm_config import RcmControllerConfig
from laploop.control.controllers.look import LookControllerConfig
from laploop.control.controllers.palpate import PalpateControllerConfig
from laploop.control.controllers.reach import ReachControllerConfig
from laploop.control.controllers.scan import ScanControllerConfig
from laploop.control.controllers.track import TrackControllerConfig
from laploop.control.prediction.harmonic_filter import HarmonicNoise
from laploop.control.prediction.rhythm_predictor import RhythmPredictorConfig
from laploop.control.prediction.rhythm_search import RhythmBand, RhythmSearchConfig
from laploop.control.targeting.targeting import TargetingConfig
from laploop.errors import InvalidValueError, LaploopError

ROOTS = [
    RcmControllerConfig,
    ReachControllerConfig,
    TrackControllerConfig,
    PalpateControllerConfig,
    ScanControllerConfig,
    LookControllerConfig,
]


def nodes(tree):
    """Yield a configuration and all that it holds."""
    yield tree
    for field in dataclasses.fields(tree):
        value = getattr(tree, field.name)
        for one in value if isinstance(value, tuple) else (value,):
            if dataclasses.is_dataclass(one):
                yield from nodes(one)


CLASSES = list({type(node): node for root in ROOTS for node in nodes(root())}.items())


@pytest.mark.parametrize("cls", ROOTS)
def test_a_file_gives_the_same_tree(cls):
    tree = cls()
    assert from_plain(cls, to_plain(tree)) == tree
    assert hash(tree) == hash(cls())


@pytest.mark.parametrize(("cls", "node"), CLASSES, ids=[cls.__name__ for cls, _ in CLASSES])
def test_every_field_says_what_it_means_and_refuses_what_it_must(cls, node):
    for field in dataclasses.fields(node):
        assert field_docs(cls).get(field.name), field.name
        for bad in (float("nan"), float("inf"), -float("inf"), -1, 1e9, "3", [1.0], {}, object(), 4 + 0j):
            if isinstance(bad, str) and isinstance(getattr(node, field.name), str):
                continue
            with pytest.raises(LaploopError, match=field.name):
                replace(node, **{field.name: bad})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: RcmControllerConfig(max_insertion_m=0.01),
            r"max_insertion_m is 0\.01; allowed: above min_insertion_m",
        ),
        (lambda: RcmControllerConfig(wall_outwards=(0.0, 0.0, 0.0)), "wall_outwards is .*; allowed: a vector that is not zero"),
        (lambda: TargetingConfig(patch_radius_m=0.02), r"patch_radius_m is 0\.02; allowed: at most track_radius_m"),
        (lambda: TargetingConfig(min_track_points=200), r"min_track_points is 200; allowed: at most track_points \(160\)"),
        (lambda: HarmonicNoise(measurement_floor_m=0.001), r"measurement_ceiling_m is 0\.0006; allowed: at least"),
        (lambda: RhythmBand(lowest_hz=1.0, highest_hz=0.5, harmonics=1, step_hz=0.1), r"highest_hz is 0\.5; allowed: at least"),
        (lambda: RhythmSearchConfig(min_span_s=20.0), r"min_span_s is 20\.0; allowed: at most span_s \(10\.0\)"),
        (lambda: RhythmPredictorConfig(patience=3), r"patience is 3; allowed: at least persistence \(4\)"),
        (lambda: RhythmPredictorConfig(window=20), r"trial is 25; allowed: at most window \(20\)"),
        (lambda: ScanControllerConfig(standoff_m=0.02), r"standoff_m is 0\.02; allowed: at most approach\.distances"),
        (
            lambda: ScanControllerConfig(waiting_error_m=0.0004),
            r"waiting_error_m is 0\.0004; allowed: above full_speed",
        ),
    ],
)
def test_fields_are_checked_against_each_other(make, message):
    with pytest.raises(InvalidValueError, match=message):
        make()


def test_the_alarm_is_two_newtons_and_contact_ends_before_it():
    for cls in (ReachControllerConfig, TrackControllerConfig, PalpateControllerConfig, ScanControllerConfig):
        approach = cls().approach
        assert (approach.withdraw_force_n, approach.alarm_force_n) == (1.2, 2.0)


def test_configurations_are_imported_without_anything_heavy():
    modules = sorted({cls.__module__ for cls, _ in CLASSES})
    heavy = {"pinocchio", "pink", "qpsolvers", "mujoco", "warp", "torch", "cv2", "zarr", "scipy"}
    script = f"import sys, {', '.join(modules)}; sys.exit(', '.join({heavy!r} & set(sys.modules)) or None)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 0, done.stderr
