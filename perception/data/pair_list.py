"""The list of a bench's own pairs: which picture goes with which cloud, in which split, of which scene.

`pairs.csv` has a header and a line for each pair:

| column | what |
|---|---|
| `image` | path of the picture, from the folder of the list |
| `cloud` | path of the point cloud |
| `split` | train, val or test |
| `scene` | name of the tissue or phantom; a scene is in one split alone, and intervals are over scenes |
| `tool` | 1 where an instrument is in view, 0 where none is; may be left out |
"""

import csv
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from laploop.errors import InvalidValueError, UnknownNameError, check_file
from laploop.perception.data.dataset import SPLITS

LIST = "pairs.csv"
_COLUMNS = ("image", "cloud", "split", "scene")
_OPTIONAL = "tool"


@dataclass(frozen=True, kw_only=True)
class ListedPair:
    """One line of the list."""

    image: Path
    cloud: Path
    split: str
    scene: str
    tool: bool


@dataclass(frozen=True, kw_only=True)
class PairList:
    """All lines, in their order."""

    pairs: tuple[ListedPair, ...]

    @classmethod
    def read(cls, folder: Path) -> "PairList":
        """Read `pairs.csv` of a folder and check that all files it names are there.

        Raises:
            MissingFileError: If the list, a picture or a cloud is not there.
            InvalidValueError: If a line is incomplete, a picture is listed twice, or a scene is in two splits; the message says
                which line.
            UnknownNameError: If a split is unknown.
        """
        path = check_file("list of pairs", folder / LIST, f"give a folder with {LIST}, pictures and clouds")
        try:
            # Spreadsheets put a byte order mark in front.
            lines = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines(), strict=True))
        except (UnicodeDecodeError, csv.Error, OSError) as error:
            raise InvalidValueError("list of pairs", str(path), f"a CSV file in UTF-8 ({error})") from error
        if not lines:
            raise InvalidValueError(f"number of pairs in {path}", 0, f"1 or more, below a header {','.join(_COLUMNS)}")
        if missing := [name for name in _COLUMNS if name not in lines[0]]:
            found = [str(name) for name in lines[0]]
            raise InvalidValueError(f"columns of {path}", found, f"also {', '.join(missing)}")
        pairs = tuple(_pair(path, number, line) for number, line in enumerate(lines, start=2))
        _check_unique(path, pairs)
        return cls(pairs=pairs)

    @cached_property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes, in the order in which they first appear."""
        return tuple(dict.fromkeys(pair.scene for pair in self.pairs))

    @property
    def scene_number(self) -> NDArray[np.int64]:
        """(N,), index into `scenes`."""
        return np.array([self.scenes.index(pair.scene) for pair in self.pairs], dtype=np.int64)

    @property
    def split(self) -> NDArray[np.uint8]:
        """(N,), index into `SPLITS`."""
        return np.array([SPLITS.index(pair.split) for pair in self.pairs], dtype=np.uint8)

    @property
    def tool_in_view(self) -> NDArray[np.bool_]:
        """(N,), pairs with an instrument in view."""
        return np.array([pair.tool for pair in self.pairs])


def _pair(path: Path, number: int, line: dict[str, str | None]) -> ListedPair:
    where = f"line {number} of {path}"
    values = {name: (line.get(name) or "").strip() for name in _COLUMNS}
    if empty := [name for name, value in values.items() if not value]:
        raise InvalidValueError(f"{', '.join(empty)} in {where}", "", "not empty")
    if values["split"] not in SPLITS:
        raise UnknownNameError(f"split in {where}", values["split"], SPLITS)
    tool = (line.get(_OPTIONAL) or "0").strip()
    if tool not in {"0", "1"}:
        raise InvalidValueError(f"tool in {where}", tool, "0 or 1")
    image, cloud = (
        check_file(f"{name} in {where}", path.parent / values[name], "give its path from the folder of the list")
        for name in ("image", "cloud")
    )
    return ListedPair(image=image, cloud=cloud, split=values["split"], scene=values["scene"], tool=tool == "1")


def _check_unique(path: Path, pairs: tuple[ListedPair, ...]) -> None:
    line_of: dict[Path, int] = {}
    split_of: dict[str, str] = {}
    for number, pair in enumerate(pairs, start=2):
        if (before := line_of.setdefault(pair.image, number)) != number:
            raise InvalidValueError(f"image in line {number} of {path}", str(pair.image), f"one not in line {before} too")
        if split_of.setdefault(pair.scene, pair.split) != pair.split:
            splits = (split_of[pair.scene], pair.split)
            raise InvalidValueError(f"splits of scene {pair.scene} in {path}", splits, "one: no scene is trained and tested on")
