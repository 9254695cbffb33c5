"""Bad files of every kind that commands read: each refused in one line, with status 2, and nothing written."""

import shutil
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import zarr
from damaged_demonstrations import LEROBOT, MINARI, edited
from demonstration_files import card_of, made_up, spaces_for

from laploop.assets.scope_optics import ScopeOptics
from laploop.cli.main import main
from laploop.perception.calibration.calibration_file import save_calibration
from laploop.perception.calibration.results import CameraCalibration, StereoCalibration
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.pair_store import PairFrame, PairStore
from laploop.perception.geometry import Intrinsics, Rig
from laploop.perception.reprojection import BrownDistortion
from laploop.studies.demonstrations.lerobot_writer import write_lerobot
from laploop.studies.demonstrations.minari_format import write_minari
from laploop.studies.demonstrations.recorded import open_demonstrations

OPTICS = ScopeOptics(width=64, height=64)
REGION = Intrinsics(width=24, height=20, fx=80.0, fy=80.0, cx=12.0, cy=10.0)
PLAN = {
    "optics": OPTICS,
    "tissue_seed": np.arange(3),
    "split": np.arange(3, dtype=np.uint8),
    "tool_in_view": np.zeros(3, bool),
    "config": {},
}
LEAST_NUMBER = 80


@dataclass(frozen=True, kw_only=True)
class BadFile:
    """A bad file, and the command that is given it."""

    name: str
    make: Callable[[Path, "GoodFiles"], Path]
    """Makes the file in a folder and returns its path."""
    command: Callable[[Path, "GoodFiles"], list[str]]


class GoodFiles:
    """One good file of each kind, to be spoilt in a copy."""

    def __init__(self, folder):
        self.frames, self.pairs, self.calibration = folder / "frames", folder / "pairs", folder / "calibration.json"
        scope, region = (64, 64), (20, 24)
        image = np.random.default_rng(0).integers(1, 200, scope, dtype=np.uint8)
        depth_mm = np.full(scope, 90.0, np.float32)
        store = FrameStore.create(self.frames, **PLAN)
        for index in range(3):
            store.write(index, image=image + np.uint8(index), depth_mm=depth_mm + np.float32(index), lit=np.ones(scope, bool))
        camera = {
            "distortion": BrownDistortion(),
            "view_errors_px": (0.1,) * 5,
            "camera_from_board": np.stack([np.eye(4)] * 5),
        }
        stereo = StereoCalibration(
            scope=CameraCalibration(intrinsics=Rig.from_optics(OPTICS).camera, **camera),
            reference=CameraCalibration(intrinsics=REGION, **camera),
            scope_from_reference=np.eye(4),
            view_errors_px=(0.1,) * 5,
        )
        save_calibration(self.calibration, stereo)
        pairs = PairStore.create(
            self.pairs, reference_intrinsics=REGION, true_scope_from_reference=np.eye(4), calibration=stereo, **PLAN
        )
        frame = PairFrame(
            image=image,
            reference_depth_mm=depth_mm,
            depth_mm=depth_mm,
            lit=np.ones(scope, bool),
            shadow=np.zeros(scope, bool),
            projector_x=np.zeros(scope, np.float32),
            projector_y=np.zeros(scope, np.float32),
            reference_z_mm=np.full(region, 90.0, np.float32),
            reference_rgba=np.zeros((*region, 4), np.uint8),
        )
        for index in range(3):
            pairs.write(index, frame, {"index": index})
        self.lerobot, self.minari = folder / "lerobot", folder / "minari"
        self.lerobot.mkdir()
        write_lerobot(self.lerobot, card_of("depth+state"), [made_up(seed, observation="depth+state") for seed in range(2)])
        self.minari.mkdir()
        write_minari(self.minari, card_of(), spaces_for("state"), [made_up(seed) for seed in range(2)])


def _written(content: bytes | str, name: str = "file") -> Callable[[Path, GoodFiles], Path]:
    def make(folder, _good):
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
        return folder / name

    return make


def _folder(folder: Path, _good: GoodFiles) -> Path:
    (folder / "folder.stl").mkdir()
    return folder / "folder.stl"


NO_FILES = {
    "missing": lambda folder, _: folder / "missing.stl",
    "name too long": lambda folder, _: folder / f"{'n' * 300}.stl",
    "a folder": _folder,
    "unknown user": lambda *_: Path("~nosuchuser/file.stl"),
}
"""Paths that are no file; only phantoms look at the suffix."""


def _copied(kind: str, damage: Callable[[Path], object]) -> Callable[[Path, GoodFiles], Path]:
    def make(folder, good):
        path = folder / kind
        shutil.copytree(getattr(good, kind), path)
        damage(path)
        return path

    return make


def _flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 16
    path.write_bytes(content)


def _attributes(change: Callable[[dict], object]) -> Callable[[Path], None]:
    return lambda path: edited(path / "zarr.json", lambda content: change(content["attributes"]))


STRUCTURE = {
    "truncated metadata": lambda path: (path / "zarr.json").write_text((path / "zarr.json").read_text()[:200]),
    "empty metadata": lambda path: (path / "zarr.json").write_bytes(b""),
    "binary metadata": lambda path: (path / "zarr.json").write_bytes(bytes(range(256))),
    "deep metadata": lambda path: (path / "zarr.json").write_text("[" * 100_000),
    "no attributes": lambda path: edited(path / "zarr.json", lambda content: content.update(attributes={})),
    "no config": _attributes(lambda attributes: attributes.pop("config")),
    "another baseline": _attributes(lambda attributes: attributes["optics"].update(baseline_m=0.007)),
    "older version": _attributes(lambda attributes: attributes.update(format=f"{attributes['format'][:-1]}1")),
    "no depth": lambda path: shutil.rmtree(path / "depth_mm"),
    "truncated array": lambda path: (path / "image" / "zarr.json").write_text('{"shape": [3,'),
    "another type": lambda path: edited(path / "depth_mm" / "zarr.json", lambda content: content.update(data_type="int32")),
    "another shape": lambda path: edited(path / "image" / "zarr.json", lambda content: content.update(shape=[3, 32, 32])),
    "missing plan": lambda path: (path / "split" / "c" / "0").unlink(),
    "flipped plan": lambda path: _flipped(path / "tissue_seed" / "c" / "0"),
}
CHUNKS = {
    "missing chunk": lambda chunk: chunk.unlink(),
    "empty chunk": lambda chunk: chunk.write_bytes(b""),
    "flipped chunk": _flipped,
    "truncated chunk": lambda chunk: chunk.write_bytes(chunk.read_bytes()[:10]),
    "chunk of another array": lambda chunk: shutil.copy(chunk.parents[1] / "image" / chunk.name, chunk),
}


def _chunk_of(index: int, damage: Callable[[Path], object]) -> Callable[[Path], object]:
    return lambda path: damage(path / "depth_mm" / f"c.{index}.0.0")


def _evaluate(path, _good):
    return ["evaluate", "--dataset", str(path), "--models", "oracle", "--resamples", "2"]


def _train(path, _good):
    return ["train", "--dataset", str(path), "--size", "tiny", "--epochs", "1", "--model", "dual-unet"]


def _foreign(folder, _good):
    zarr.create_group(folder / "foreign", attributes={"format": "other"})
    return folder / "foreign"


DATA_SETS = [
    *(BadFile(name=f"data set: {name}", make=make, command=_evaluate) for name, make in NO_FILES.items()),
    BadFile(name="data set: a file", make=_written("x"), command=_train),
    BadFile(name="data set: foreign Zarr", make=_foreign, command=_train),
    *(BadFile(name=f"frames: {name}", make=_copied("frames", damage), command=_train) for name, damage in STRUCTURE.items()),
    *(BadFile(name=f"pairs: {name}", make=_copied("pairs", damage), command=_evaluate) for name, damage in STRUCTURE.items()),
    BadFile(
        name="pairs: calibration of another",
        make=_copied("pairs", lambda path: edited(path / "calibration.json", lambda content: content.update(version=1.0))),
        command=_evaluate,
    ),
    BadFile(
        name="pairs: no calibration",
        make=_copied("pairs", lambda path: (path / "calibration.json").unlink()),
        command=_evaluate,
    ),
    *(
        BadFile(name=f"frames, train: {name}", make=_copied("frames", _chunk_of(0, damage)), command=_train)
        for name, damage in CHUNKS.items()
    ),
    *(
        BadFile(name=f"frames, evaluate: {name}", make=_copied("frames", _chunk_of(2, damage)), command=_evaluate)
        for name, damage in CHUNKS.items()
    ),
    *(
        BadFile(name=f"pairs, evaluate: {name}", make=_copied("pairs", _chunk_of(2, damage)), command=_evaluate)
        for name, damage in CHUNKS.items()
    ),
]


def _replay(path, _good):
    return ["replay", str(path)]


DEMONSTRATIONS = [
    *(BadFile(name=f"demonstrations: {name}", make=make, command=_replay) for name, make in NO_FILES.items()),
    *(BadFile(name=f"LeRobot: {name}", make=_copied("lerobot", damage), command=_replay) for name, damage in LEROBOT.items()),
    *(BadFile(name=f"Minari: {name}", make=_copied("minari", damage), command=_replay) for name, damage in MINARI.items()),
]


def _safetensors(header: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header


WEIGHTS = [
    BadFile(
        name=f"weights: {name}",
        make=make,
        command=lambda path, good: [
            "evaluate",
            "--dataset",
            str(good.frames),
            "--models",
            "compact",
            "--weights",
            "compact",
            str(path),
        ],
    )
    for name, make in {
        **NO_FILES,
        "empty": _written(b""),
        "text": _written("not weights"),
        "pickle": _written(b"\x80\x04K\x01."),
        "header null": _written(_safetensors(b"null")),
        "header text": _written(_safetensors(b'"text"')),
        "header deep": _written(_safetensors(b"[" * 50_000)),
        "header of another": _written(_safetensors(b'{"__metadata__":{"architecture":"[1]"}}')),
        "header longer than the file": _written(struct.pack("<Q", 10**9) + b"{}"),
    }.items()
]


def _spoilt_calibration(change: Callable[[dict], object]) -> Callable[[Path, GoodFiles], Path]:
    def make(folder, good):
        shutil.copy(good.calibration, folder / "calibration.json")
        edited(folder / "calibration.json", change)
        return folder / "calibration.json"

    return make


CALIBRATIONS = [
    BadFile(
        name=f"calibration: {name}",
        make=make,
        command=lambda path, _good: ["collect", "--pairs", "1", "--calibration", str(path)],
    )
    for name, make in {
        **NO_FILES,
        "empty": _written(b""),
        "text": _written("fx: 223"),
        "list": _written("[]"),
        "deep": _written("[" * 100_000),
        "UTF-16": _written("{}".encode("utf-16")),
        "NaN": _written('{"schema": NaN}'),
        "of another scope": _spoilt_calibration(lambda content: None),
        "other schema": _spoilt_calibration(lambda content: content.update(schema="bench")),
        "infinite": _spoilt_calibration(lambda content: content["cameras"]["scope"].update(fx=10**400)),
        "a million metres": _spoilt_calibration(
            lambda content: content["transforms"]["scope_from_reference"][0].__setitem__(3, 1e6)
        ),
        "other shape": _spoilt_calibration(lambda content: content["transforms"].update(scope_from_reference=[[1.0]])),
    }.items()
]

TRACES = [
    BadFile(name=f"latency trace: {name}", make=make, command=lambda path, _good: ["run", "--latency-trace", str(path)])
    for name, make in {
        **NO_FILES,
        "empty": _written(b""),
        "binary": _written(bytes(range(256))),
        "UTF-16": _written("latency_ms\n40\n".encode("utf-16")),
        "no column": _written("ms\n40\n"),
        "no rows": _written("latency_ms\n"),
        "two numbers in a row": _written("latency_ms\n40,5\n"),
        "text": _written("latency_ms\nforty\n"),
        "infinite": _written("latency_ms\n1e400\n"),
        "negative": _written("latency_ms\n-1\n"),
        "huge field": _written("latency_ms\n" + "9" * 200_000 + "\n"),
    }.items()
]

PHANTOMS = [
    BadFile(
        name=f"phantom: {name}",
        make=make,
        command=lambda path, _good: ["run", "--phantom", str(path), "--perception", "oracle", "--no-rerun"],
    )
    for name, make in {
        **NO_FILES,
        "empty": _written(b"", "body.stl"),
        "text": _written("not a mesh", "body.ply"),
        "binary": _written(bytes(range(256)) * 4, "body.stl"),
        "points alone": _written("v 0 0 0\nv 1 0 0\n", "body.obj"),
        "open surface": _written("v 0 0 0\nv 50 0 0\nv 0 50 0\nv 0 0 50\nf 1 3 2\nf 1 2 4\n", "body.obj"),
        "unknown suffix": _written("x", "body.step"),
    }.items()
]

CONFIGURATIONS = [
    BadFile(name=f"configuration: {name}", make=make, command=lambda path, _good: ["run", "--config", str(path)])
    for name, make in {
        **NO_FILES,
        "binary": _written(bytes(range(256))),
        "UTF-16": _written("seed = 1".encode("utf-16")),
        "no TOML": _written("seed = "),
        "deep": _written('{"a":' * 100_000),
        "unknown field": _written("sed = 1"),
        "of another type": _written('seed = "one"'),
        "out of bounds": _written("[task.loop]\ncamera_hz = -5.0"),
        "not finite": _written("[task]\nmax_seconds = nan"),
        "code": _written('[perception]\nname = "os:system"'),
        "null": _written('{"config": null, "command": "run"}'),
    }.items()
]

BAD_FILES = [*DATA_SETS, *DEMONSTRATIONS, *WEIGHTS, *CALIBRATIONS, *TRACES, *PHANTOMS, *CONFIGURATIONS]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return GoodFiles(tmp_path_factory.mktemp("good"))


def test_there_are_enough_bad_files_and_each_has_a_name_of_its_own():
    assert len({bad.name for bad in BAD_FILES}) == len(BAD_FILES) >= LEAST_NUMBER


@pytest.mark.parametrize("bad", BAD_FILES, ids=lambda bad: bad.name)
def test_bad_file_is_refused_in_one_line_and_nothing_is_written(bad, good, tmp_path, capsys):
    path = bad.make(tmp_path, good)
    before = sorted(tmp_path.rglob("*"))
    arguments = bad.command(path, good)
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith(f"laploop {arguments[0]}: ") for line in lines) == 1
    assert lines[-1].startswith(f"laploop {arguments[0]}: ")
    # It names the file: it is not refused for anything else.
    assert path.name in lines[-1] or bad.name == "phantom: unknown suffix"
    assert "Traceback" not in "".join(lines)
    assert sorted(tmp_path.rglob("*")) == before


def test_the_good_files_are_good(good):
    """Otherwise what is refused above might be refused for another reason."""
    for kind, path in ((FrameStore, good.frames), (PairStore, good.pairs)):
        kind.open(path).verify(range(3))
    for path in (good.lerobot, good.minari):
        found = open_demonstrations(path)
        assert [found.episode(index).outcome for index in range(found.count)] == [made_up(seed).outcome for seed in range(2)]
