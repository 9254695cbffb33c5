"""The layout of LeRobot's data sets, version 3.0, and how an episode's arrays become its features.

Files: `meta/info.json`, `meta/stats.json`, `meta/tasks.parquet`, `meta/episodes/chunk-000/file-000.parquet`, and
`data/chunk-000/file-000.parquet`, ..., a row a decision and a row group an episode. Images are in the rows: stripes as PNG with
three equal channels, as LeRobot's policies take them; depth as TIFF of 32-bit floating-point millimetres, 0 where it is not
valid. A row holds what was observed before its action, so that the observation after the last action is missing.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from laploop.envs.learning.encoding import decode_depth, encode_depth
from laploop.errors import DatasetError
from laploop.studies.demonstrations.card import Card
from laploop.studies.demonstrations.demonstration import Demonstration

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
TASKS = "meta/tasks.parquet"
INFO = "meta/info.json"
STATS = "meta/stats.json"
CARD = "meta/laploop.json"
"""The one file that the layout does not know: the card, and the outcome of each episode."""

CHUNK_FILES = 1000
FILE_MB = 100

IMAGE = "observation.images."
STATE = "observation.state"
ACTION = "action"
_VECTORS = ("state", "proprioception")
"""Keys of the observation that become `STATE`."""

_COUNTERS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Features that every data set has, and the type of their one number."""

Columns = dict[str, NDArray[Any]]
Feature = dict[str, Any]


def features_of(card: Card, columns: Mapping[str, NDArray[Any]]) -> dict[str, Feature]:
    """Return the description of each feature, from an episode's columns."""
    names = [
        name if end - begin == 1 else f"{name}.{part}"
        for name, (begin, end) in card.entries.items()
        for part in range(end - begin)
    ]
    found: dict[str, Feature] = {}
    for key, column in columns.items():
        if key.startswith(IMAGE):
            found[key] = _image_feature(card, key, column)
        else:
            labels = {STATE: names, ACTION: ["x", "y", "z"], "expert_action": ["x", "y", "z"]}.get(key)
            shape = list(column.shape[1:]) or [1]
            found[key] = {"dtype": str(column.dtype), "shape": shape, "names": labels}
    return found | {name: {"dtype": dtype, "shape": [1], "names": None} for name, dtype in _COUNTERS.items()}


def columns_of(demonstration: Demonstration) -> Columns:
    """Return an episode's features without the counters, (decisions, ...) each; images as they are shown to the reader."""
    found: Columns = {}
    for key, observed in demonstration.observations.items():
        before = observed[:-1]
        if key in _VECTORS:
            found[STATE] = before
        elif key == "depth":
            found[IMAGE + key] = np.nan_to_num(decode_depth(before))[..., None]
        else:
            found[IMAGE + key] = np.repeat(before, 3, axis=-1)
    done = demonstration.terminations | demonstration.truncations
    return found | {
        ACTION: demonstration.actions,
        "expert_action": demonstration.expert_actions[:-1],
        "privileged": demonstration.privileged[:-1],
        "next.reward": demonstration.rewards.astype(np.float32),
        "next.done": done,
        "next.truncated": demonstration.truncations,
        "next.success": demonstration.successes[1:],
    }


def observations_of(columns: Mapping[str, NDArray[Any]], card: Card) -> dict[str, NDArray[Any]]:
    """Return what the environment observed, (decisions, ...) by key, of an episode's columns."""
    observed = card.keywords.get("observation", "state")
    found = {"state" if "state" in observed else "proprioception": columns[STATE]}
    for key, column in columns.items():
        if key == f"{IMAGE}depth":
            found["depth"] = encode_depth(column[..., 0], column[..., 0] > 0.0)
        elif key.startswith(IMAGE):
            found[key.removeprefix(IMAGE)] = column[..., :1]
    return found


def encoded_image(image: NDArray[Any]) -> bytes:
    """Return an image, (height, width, channels), as PNG, or as TIFF where its values are not bytes."""
    extension = ".png" if image.dtype == np.uint8 else ".tiff"
    done, data = cv2.imencode(extension, image)
    if not done:
        raise DatasetError(f"an image of {image.dtype} and shape {image.shape} cannot be written as {extension}")
    return data.tobytes()


def decoded_image(data: bytes) -> NDArray[Any]:
    """Return what `encoded_image` encoded.

    Raises:
        DatasetError: If it is no image.
    """
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DatasetError("an image of the data set is damaged")
    return np.asarray(image if image.ndim == 3 else image[..., None])


def _image_feature(card: Card, key: str, column: NDArray[Any]) -> Feature:
    feature: Feature = {"dtype": "image", "shape": list(column.shape[1:]), "names": ["height", "width", "channels"]}
    if key == f"{IMAGE}depth":
        near_mm, far_mm = card.depth_range_mm
        feature["info"] = {
            "is_depth_map": True,
            "depth_unit": "mm",
            "depth_min_mm": near_mm,
            "depth_max_mm": far_mm,
            "invalid": 0.0,
        }
    return feature
