"""What may be wrong with a data set of demonstrations: by name, what does the damage to its folder."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
from pyarrow import parquet


def edited(path: Path, change: Callable[[dict], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def in_json(name: str, change: Callable[[dict], object]) -> Callable[[Path], None]:
    return lambda path: edited(path / name, change)


def in_table(pattern: str, change: Callable[[pa.Table], pa.Table]) -> Callable[[Path], None]:
    def damage(path):
        (file,) = path.glob(pattern)
        parquet.write_table(change(parquet.read_table(file, partitioning=None)), file)

    return damage


def without(column: str) -> Callable[[pa.Table], pa.Table]:
    return lambda table: table.drop_columns([column])


def as_text(column: str) -> Callable[[pa.Table], pa.Table]:
    return lambda table: table.set_column(
        table.column_names.index(column), column, pa.array(["text"] * table.num_rows, pa.string())
    )


def cut(pattern: str) -> Callable[[Path], None]:
    def damage(path):
        (file,) = path.glob(pattern)
        file.write_bytes(file.read_bytes()[:100])

    return damage


CARDS = {
    "another layout": lambda card: card.update(layout=0),
    "another version": lambda card: card.update(laploop="0.0.1"),
    "no keywords": lambda card: card.pop("keywords"),
    "keywords that are no table": lambda card: card.update(keywords=5),
    "a range of one depth": lambda card: card.update(depth_range_mm=[40.0]),
    "an unknown field": lambda card: card.update(colour="red"),
    "a task of another type": lambda card: card.update(task=["reach"]),
}
"""Damage to a card."""
OUTCOMES = {
    "no seed": lambda outcome: outcome.pop("seed"),
    "no decisions": lambda outcome: outcome.pop("decisions"),
    "no randomisation": lambda outcome: outcome.pop("randomisation"),
    "a seed in words": lambda outcome: outcome.update(seed="three"),
    "a negative seed": lambda outcome: outcome.update(seed=-3),
    "a randomisation that is no table": lambda outcome: outcome.update(randomisation=5),
}
"""Damage to the outcome of the first episode."""

LEROBOT = {
    **{f"card with {name}": in_json("meta/laploop.json", change) for name, change in CARDS.items()},
    **{
        f"outcome with {name}": in_json("meta/laploop.json", lambda card, change=change: change(card["episodes"][0]))
        for name, change in OUTCOMES.items()
    },
    "of an older LeRobot": in_json("meta/info.json", lambda info: info.update(codebase_version="v2.1")),
    "of LeRobot alone": lambda path: (path / "meta" / "laploop.json").unlink(),
    "a list for a card": lambda path: (path / "meta" / "laploop.json").write_text("[]"),
    "a deep card": lambda path: (path / "meta" / "laploop.json").write_text("[" * 100_000),
    "no outcomes": in_json("meta/laploop.json", lambda card: card.pop("episodes")),
    "an outcome too few": in_json("meta/laploop.json", lambda card: card["episodes"].pop()),
    "an outcome that is no table": in_json("meta/laploop.json", lambda card: card.update(episodes=["first", "second"])),
    "binary info": lambda path: (path / "meta" / "info.json").write_bytes(bytes(range(256))),
    **{f"episodes without {name}": in_table("meta/episodes/*/*", without(name)) for name in ("length", "data/file_index")},
    "a file with a name": in_table("meta/episodes/*/*", as_text("data/file_index")),
    "no table of episodes": lambda path: shutil.rmtree(path / "meta" / "episodes"),
    "truncated episodes": cut("meta/episodes/*/*"),
    **{
        f"data without {name}": in_table("data/*/*", without(name))
        for name in ("episode_index", "observation.state", "action", "expert_action", "next.reward", "next.truncated")
    },
    "data with an end in words": in_table("data/*/*", as_text("next.truncated")),
    "data with a picture in words": in_table("data/*/*", as_text("observation.images.depth")),
    "data with fewer rows": in_table("data/*/*", lambda table: table.slice(1)),
    "truncated data": cut("data/*/*"),
    "no data": lambda path: shutil.rmtree(path / "data"),
}
MINARI = {
    **{
        f"card with {name}": in_json("metadata.json", lambda found, change=change: change(found["laploop"]))
        for name, change in CARDS.items()
    },
    **{
        f"outcome with {name}": in_json("0/metadata.json", lambda found, change=change: change(found["laploop"]))
        for name, change in OUTCOMES.items()
    },
    "of others": in_json("metadata.json", lambda found: found.pop("laploop")),
    "no outcome": in_json("0/metadata.json", lambda found: found.pop("laploop")),
    "an outcome in a list": lambda path: (path / "0" / "metadata.json").write_text("[]"),
    "deep metadata": lambda path: (path / "metadata.json").write_text("[" * 100_000),
    **{
        f"metadata without {name}": in_json("metadata.json", lambda found, name=name: found.pop(name))
        for name in ("total_episodes", "action_space", "data_format", "dataset_id")
    },
    "episodes in words": in_json("metadata.json", lambda found: found.update(total_episodes="two")),
    "another format": in_json("metadata.json", lambda found: found.update(data_format="zip")),
    **{f"data without {name}": in_table("0/*.parquet", without(name)) for name in ("observations", "actions", "infos")},
    "data with rewards in words": in_table("0/*.parquet", as_text("rewards")),
    "truncated data": cut("0/*.parquet"),
    "no data": lambda path: shutil.rmtree(path / "0"),
}
