"""The contract of every configuration: strict, frozen, errors of ours that name the field."""

import pickle
from dataclasses import FrozenInstanceError, field, replace
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest

from laploop.configuration import Field, allowed, configuration, field_docs, from_plain, to_plain
from laploop.errors import InvalidValueError, LaploopError, UnknownNameError


@configuration
class Lens:
    focal_mm: Annotated[float, Field(gt=0.0, le=50.0)] = 4.0
    """Focal length."""
    elements: Annotated[int, Field(ge=1, le=20)] = 6
    coating: Literal["none", "single", "multi"] = "multi"
    centre_px: tuple[float, float] = (128.0, 128.0)
    columns: Annotated[int, Field(ge=16, le=4096, multiple_of=2)] = 256
    filters: Annotated[tuple[float, ...], Field(min_length=1, max_length=3)] = (0.5,)
    profile: Path | None = None


@configuration
class Fixed:
    kind: Literal["fixed"] = "fixed"
    exposure_s: float = 0.01


@configuration
class Automatic:
    kind: Literal["automatic"] = "automatic"
    target: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5


@configuration
class Camera:
    lens: Lens = field(default_factory=Lens)
    exposure: Annotated[Fixed | Automatic, Field(discriminator="kind")] = field(default_factory=Fixed)
    gain: Annotated[float, Field(ge=0.1, le=10.0)] | None = None

    def __post_init__(self):
        if self.gain is not None and self.exposure.kind == "automatic":
            raise InvalidValueError("gain", self.gain, "none with automatic exposure")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal_mm": float("nan")}, "focal_mm is nan; allowed: above 0, at most 50"),
        ({"focal_mm": float("inf")}, "focal_mm is inf; allowed: above 0, at most 50"),
        ({"focal_mm": 0.0}, "focal_mm is 0.0; allowed: above 0, at most 50"),
        ({"focal_mm": True}, "focal_mm is True; allowed: above 0, at most 50"),
        ({"focal_mm": "4"}, "focal_mm is '4'; allowed: above 0, at most 50"),
        ({"focal_mm": None}, "focal_mm is None; allowed: above 0, at most 50"),
        ({"focal_mm": Decimal(4)}, "focal_mm is Decimal('4'); allowed: a plain number"),
        ({"focal_mm": 4 + 0j}, "focal_mm is (4+0j); allowed: a plain number"),
        ({"elements": 6.0}, "elements is 6.0; allowed: an integer, 1 to 20"),
        ({"elements": True}, "elements is True; allowed: an integer, 1 to 20"),
        ({"coating": "gold"}, "unknown coating 'gold'; available: multi, none, single"),
        ({"centre_px": [1.0, 2.0]}, "centre_px is [1.0, 2.0]; allowed: 2 values, each a finite number"),
        ({"centre_px": (1.0, float("inf"))}, "centre_px.1 is inf; allowed: a finite number"),
        ({"columns": 17}, "columns is 17; allowed: a multiple of 2, 16 to 4096"),
        ({"filters": ()}, "filters is (); allowed: 1 to 3 values, each a finite number"),
        ({"profile": "a.json"}, "profile is 'a.json'; allowed: a path, or none"),
        ({"focal": 4.0}, "unknown field 'focal'; did you mean 'focal_mm'? available: "),
    ],
)
def test_what_is_not_allowed_is_refused_by_name(changes, message):
    with pytest.raises(LaploopError) as caught:
        Lens(**changes)
    assert str(caught.value).startswith(message)


def test_numbers_of_numpy_become_plain_ones():
    lens = Lens(focal_mm=np.float64(5.0), elements=np.int64(3), centre_px=(np.float32(1.0), 2.0))
    assert [type(value) for value in (lens.focal_mm, lens.elements, lens.centre_px[0])] == [float, int, float]


def test_configurations_are_frozen_hashable_and_picklable():
    camera = Camera()
    with pytest.raises(FrozenInstanceError):
        camera.gain = 2.0
    assert pickle.loads(pickle.dumps(camera)) == camera  # noqa: S301  our own bytes
    assert hash(camera) == hash(Camera())


def test_a_replaced_field_is_checked_like_any_other():
    with pytest.raises(InvalidValueError, match=r"gain is 20\.0; allowed: 0\.1 to 10, or none"):
        replace(Camera(), gain=20.0)


def test_fields_are_checked_against_each_other():
    with pytest.raises(InvalidValueError, match="none with automatic exposure"):
        Camera(gain=1.0, exposure=Automatic())


def test_plain_values_come_back_as_the_same_tree():
    camera = Camera(lens=Lens(profile=Path("lens.json")), exposure=Automatic(target=0.25))
    plain = to_plain(camera)
    assert plain["exposure"] == {"kind": "automatic", "target": 0.25}
    assert plain["lens"]["centre_px"] == [128.0, 128.0]
    assert from_plain(Camera, plain) == camera


@pytest.mark.parametrize(
    ("plain", "kind", "message"),
    [
        ({"lens": {"focal_mm": 99}}, InvalidValueError, "my.toml: lens.focal_mm is 99; allowed: above 0, at most 50"),
        ({"lens": {"focal": 1}}, UnknownNameError, "my.toml: unknown field 'lens.focal'; did you mean 'focal_mm'?"),
        ({"lens": 3}, InvalidValueError, "my.toml: lens is 3; allowed: an object"),
        ({"exposure": {"kind": "automatic", "target": 2}}, InvalidValueError, "my.toml: exposure.target is 2; allowed: 0 to 1"),
        ({"exposure": {"kind": "manual"}}, UnknownNameError, "my.toml: unknown kind of exposure 'manual'"),
        ({"gain": float("nan")}, InvalidValueError, "my.toml: gain is nan; allowed: 0.1 to 10, or none"),
        ({"lens": {"centre_px": [1, "x"]}}, InvalidValueError, "my.toml: lens.centre_px.1 is 'x'; allowed: a finite number"),
    ],
)
def test_errors_in_a_file_name_the_file_and_the_path(plain, kind, message):
    with pytest.raises(kind) as caught:
        from_plain(Camera, plain, source="my.toml")
    assert str(caught.value).startswith(message)


def test_bounds_and_docs_can_be_read_off_the_class():
    assert allowed(Camera, ("lens", "elements")) == "an integer, 1 to 20"
    assert allowed(Camera, ("exposure", "target")) == "0 to 1"
    assert field_docs(Lens) == {"focal_mm": "Focal length."}
