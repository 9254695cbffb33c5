"""Opens a data set of stripe frames of any kind."""

from pathlib import Path

from laploop.errors import DatasetError
from laploop.perception.data.dataset import DepthDataset, ReferencedDataset
from laploop.perception.data.frame_store import FrameStore
from laploop.perception.data.imported_pair_store import ImportedPairStore
from laploop.perception.data.integrity import open_group, refusing_damage
from laploop.perception.data.pair_store import PairStore

__all__ = ["AnyStore", "DepthDataset", "ReferencedDataset", "open_dataset"]

AnyStore = FrameStore | PairStore | ImportedPairStore


def open_dataset(path: str | Path) -> AnyStore:
    """Open a data set by its format and check everything except the frames, which are checked when they are read.

    Raises:
        MissingFileError: If there is none.
        DatasetError: If it is damaged, of an unknown format, or made by an older version.
    """
    path = Path(path)
    kinds = (FrameStore, PairStore, ImportedPairStore)
    commands = ", ".join(kind.COMMAND for kind in kinds[:-1]) + f" or {kinds[-1].COMMAND}"
    with refusing_damage(f"data set {path}"):
        found = open_group(path, commands).attrs.get("format")
    for kind in kinds:
        if found in (kind.FORMAT, *kind.READABLE_FORMATS, *kind.OLDER_FORMATS):
            return kind.open(path)
    raise DatasetError(f"data set {path} has the format {found!r}; allowed: one that {commands} made")
