"""`calibration.json`: a calibration, written by a bench or by the simulator.

The file holds, in metres and pixels (centre of the first pixel at (0.5, 0.5), as `units` says):

    schema, version, units
    cameras.scope:
        width, height, fx, fy, cx, cy, distortion {k1, k2, p1, p2, k3}, view_errors_px, camera_from_board

and, where they were calibrated,

    cameras.reference: as cameras.scope
    transforms.scope_from_reference: 4x4, row by row
    view_errors_px: of the pairs of views
    projector:
        projector_from_camera: 4x4, row by row
        period_tan: of the stripes, in tangents of the angle to the projector's axis
        phase_turns: of the stripes on that axis; bright ones are centred at whole numbers
        view_errors_turns
        deviations {x_m, z_m, pitch_rad, yaw_rad, roll_rad, period_tan, phase_turns}
    hand_eye:
        flange_from_camera, world_from_board: 4x4, row by row
        view_errors_px
    mask: the fields of a `StripeMask` as designed; those that are left out have their defaults

The first three go together. Other keys are ignored.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from laploop.assets.stripe_mask import StripeMask
from laploop.configuration import from_plain, to_plain
from laploop.errors import InvalidValueError, LaploopError, check_file
from laploop.perception.calibration.hand_eye import HandEyeCalibration
from laploop.perception.calibration.projector import UNKNOWNS, ProjectorCalibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.geometry import Intrinsics
from laploop.perception.reprojection import BrownDistortion
from laploop.whole_file import whole_file

SCHEMA = "laploop calibration"
VERSION = 1
UNITS = {"length": "m", "pixel": "px, the centre of the first pixel is (0.5, 0.5)"}


@dataclass(frozen=True, kw_only=True, eq=False)
class CalibrationRecord:
    """The content of a calibration file."""

    scope: CameraCalibration
    stereo: StereoCalibration | None = None
    """The scope's camera again, with the reference camera."""
    projector: ProjectorCalibration | None = None
    hand_eye: HandEyeCalibration | None = None
    mask: StripeMask | None = None
    """As designed: number, duty and field of the stripes, which the calibration of the projector does not reveal."""


def save_calibration(
    path: Path,
    calibration: StereoCalibration | CameraCalibration,
    *,
    projector: ProjectorCalibration | None = None,
    hand_eye: HandEyeCalibration | None = None,
    mask: StripeMask | None = None,
) -> None:
    """Write a calibration of both cameras, or the scope's alone, and of projector and arm where they were calibrated.

    The file appears whole or not at all, and an older one stays until then.

    Raises:
        OutputError: If the file cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_text(as_json(calibration, projector=projector, hand_eye=hand_eye, mask=mask), encoding="utf-8")


def as_json(
    calibration: StereoCalibration | CameraCalibration,
    *,
    projector: ProjectorCalibration | None = None,
    hand_eye: HandEyeCalibration | None = None,
    mask: StripeMask | None = None,
) -> str:
    """Return the content of a calibration file; see `save_calibration`."""
    content: dict[str, Any] = {"schema": SCHEMA, "version": VERSION, "units": UNITS}
    if isinstance(calibration, CameraCalibration):
        content["cameras"] = {"scope": _camera_as_dict(calibration)}
    else:
        content["cameras"] = {
            "scope": _camera_as_dict(calibration.scope),
            "reference": _camera_as_dict(calibration.reference),
        }
        content["transforms"] = {"scope_from_reference": calibration.scope_from_reference.tolist()}
        content["view_errors_px"] = list(calibration.view_errors_px)
    for name, section in (("projector", projector), ("hand_eye", hand_eye)):
        if section is not None:
            content[name] = {field.name: _plain(getattr(section, field.name)) for field in fields(section)}
    if mask is not None:
        content["mask"] = to_plain(mask)
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def load_calibration(path: Path) -> StereoCalibration:
    """Read the calibration of the two cameras; errors as of `load_record`, also for a file without a reference camera."""
    stereo = load_record(path).stereo
    if stereo is None:
        raise InvalidValueError("calibration", str(path), "one with cameras.reference and transforms.scope_from_reference")
    return stereo


def load_record(path: Path) -> CalibrationRecord:
    """Read a calibration and its optional sections.

    Raises:
        MissingFileError: If there is no such file.
        InvalidValueError: If it is not JSON, of another schema or version, in other units, or a field is missing or impossible;
            the message names the field.
    """
    path = check_file("calibration", path, "give the calibration.json of a bench or of the simulator")
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    # Deep nesting ends in a RecursionError.
    except (OSError, ValueError, RecursionError) as error:
        raise InvalidValueError("calibration", str(path), f"a JSON file that can be read ({error})") from error
    try:
        _check_header(content)
        scope = _camera(_field(content, "cameras", "scope"))
        return CalibrationRecord(
            scope=scope,
            stereo=_stereo(content, scope) if "reference" in content["cameras"] or "transforms" in content else None,
            projector=_projector(content["projector"]) if "projector" in content else None,
            hand_eye=_hand_eye(content["hand_eye"]) if "hand_eye" in content else None,
            mask=_mask(content["mask"]) if "mask" in content else None,
        )
    except InvalidValueError as error:
        raise InvalidValueError("calibration", str(path), f"a complete and valid one ({error})") from error


def _check_header(content: Any) -> None:
    for name, expected in (("schema", SCHEMA), ("version", VERSION), ("units", UNITS)):
        if (found := _field(content, name)) != expected:
            raise InvalidValueError(name, found, repr(expected))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return dict(value) if isinstance(value, Mapping) else value


def _camera_as_dict(camera: CameraCalibration) -> dict[str, Any]:
    return {
        **asdict(camera.intrinsics),
        "distortion": asdict(camera.distortion),
        "view_errors_px": list(camera.view_errors_px),
        "camera_from_board": camera.camera_from_board.tolist(),
    }


def _camera(content: Any) -> CameraCalibration:
    return CameraCalibration(
        intrinsics=Intrinsics(
            width=_whole(_field(content, "width")),
            height=_whole(_field(content, "height")),
            **{name: _number(_field(content, name)) for name in ("fx", "fy", "cx", "cy")},
        ),
        distortion=BrownDistortion(
            **{name: _number(_field(content, "distortion", name)) for name in ("k1", "k2", "p1", "p2", "k3")}
        ),
        view_errors_px=_numbers(_field(content, "view_errors_px")),
        camera_from_board=np.array([_matrix(pose) for pose in _list(_field(content, "camera_from_board"))]),
    )


def _stereo(content: Any, scope: CameraCalibration) -> StereoCalibration:
    return StereoCalibration(
        scope=scope,
        reference=_camera(_field(content, "cameras", "reference")),
        scope_from_reference=_matrix(_field(content, "transforms", "scope_from_reference")),
        view_errors_px=_numbers(_field(content, "view_errors_px")),
    )


def _mask(content: Any) -> StripeMask:
    if not isinstance(content, Mapping):
        raise InvalidValueError("mask", content, "an object with fields of a StripeMask")
    try:
        return from_plain(StripeMask, dict(content))
    except LaploopError as error:
        raise InvalidValueError("mask", dict(content), f"a StripeMask ({error})") from error


def _projector(content: Any) -> ProjectorCalibration:
    return ProjectorCalibration(
        projector_from_camera=_matrix(_field(content, "projector_from_camera")),
        period_tan=_number(_field(content, "period_tan")),
        phase_turns=_number(_field(content, "phase_turns")),
        view_errors_turns=_numbers(_field(content, "view_errors_turns")),
        deviations={name: _number(_field(content, "deviations", name)) for name in UNKNOWNS},
    )


def _hand_eye(content: Any) -> HandEyeCalibration:
    return HandEyeCalibration(
        flange_from_camera=_matrix(_field(content, "flange_from_camera")),
        world_from_board=_matrix(_field(content, "world_from_board")),
        view_errors_px=_numbers(_field(content, "view_errors_px")),
    )


def _field(content: Any, *names: str) -> Any:
    """Return a field of nested objects, none of which may be missing."""
    for depth, name in enumerate(names):
        if not isinstance(content, Mapping) or name not in content:
            raise InvalidValueError("missing field", ".".join(names[: depth + 1]), "files that have it")
        content = content[name]
    return content


def _number(value: Any) -> float:
    # Integers may have any number of digits, and 1e400 is read as infinity.
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= sys.float_info.max:
        raise InvalidValueError("number", str(value)[:50], "a finite JSON number")
    return float(value)


def _whole(value: Any) -> int:
    number = _number(value)
    if number != int(number):
        raise InvalidValueError("number", value, "a whole number of pixels")
    return int(number)


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise InvalidValueError("list", value, "a JSON list")
    return value


def _numbers(value: Any) -> tuple[float, ...]:
    return tuple(_number(entry) for entry in _list(value))


def _matrix(value: Any) -> Any:
    rows = [_numbers(row) for row in _list(value)]
    if [len(row) for row in rows] != [4] * 4:
        raise InvalidValueError("matrix", value, "four rows of four numbers")
    return np.array(rows)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")
