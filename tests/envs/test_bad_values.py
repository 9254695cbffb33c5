"""Every field of the tree refuses what it cannot be, in one line that names it; the values are made from the tree itself."""

import dataclasses
import math
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal, get_args, get_origin

import pytest

from laploop.cli.tree import leaves
from laploop.configuration import alternatives, from_plain, to_plain
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.tasks.registry import TASKS
from laploop.errors import LaploopError

NUMBERS = ("x", [], {}, True, math.nan, math.inf, -math.inf, 1e300, -1e300)


def bad_values(annotation):
    """Return what a field of this type must refuse; every number has a bound on both sides."""
    kinds = [get_args(one)[0] if get_origin(one) is Annotated else one for one in alternatives(annotation)]
    names = [get_origin(one) or one for one in kinds]
    found = [] if type(None) in names else [None]
    if Literal in names:
        found += ["nonsense", 31, [], math.nan]
    elif dict in names:
        found += ["x", 3, [], {"a": math.nan}]
    elif tuple in names:
        found += ["x", 3, True, [math.nan], ["x"], [[[]]], {}]
    elif bool in names:
        found += ["x", 3, 1.0, [], math.nan]
    elif float in names:
        found += NUMBERS
    elif int in names:
        found += [*NUMBERS, 1.5]
    elif str in names or Path in names:
        found += [3, True, [], {}, math.nan]
    return found


def every_leaf():
    seen = set()
    for task in TASKS.names():
        tree = EpisodeConfig.of(task=task)
        plain = to_plain(tree)
        for leaf in leaves(tree).values():
            # What all tasks share need not be tried five times.
            if leaf.path not in seen:
                seen.add(leaf.path)
                yield tree, plain, leaf


@contextmanager
def table_of(plain, path):
    """Give a table of a tree to change, and put it back."""
    for part in path:
        plain = plain[part]
    before = dict(plain)
    yield plain
    plain.clear()
    plain.update(before)


def refused(make, name):
    """Return why a bad value was not refused as it should be; nothing if it was."""
    try:
        make()
    except LaploopError as error:
        message = str(error)
        if "\n" in message:
            return "more than one line"
        # A choice is named in words, and the kind of a thing by the thing.
        return "" if name == "kind" or name in message.replace(" ", "_") else f"does not name it: {message}"
    except Exception as error:  # noqa: BLE001  what is looked for
        return f"{type(error).__name__}: {error}"
    return "accepted"


def test_every_field_of_a_file_refuses_what_it_cannot_be():
    wrong, tried = [], 0
    for _, plain, leaf in every_leaf():
        name = leaf.path[-1]
        for value in bad_values(leaf.annotation):
            with table_of(plain, leaf.path[:-1]) as table:
                # Fields of alternatives that the tree has not chosen are not in it.
                if name in table:
                    table[name] = value
                    tried += 1
                    reason = refused(lambda plain=plain: from_plain(EpisodeConfig, plain), name)
                    wrong += [(".".join(leaf.path), value, reason)] if reason else []
    assert wrong == []
    assert tried > 800


def test_every_field_in_python_refuses_what_it_cannot_be():
    wrong, tried = [], 0
    for tree, _, leaf in every_leaf():
        owner = tree
        for part in leaf.path[:-1]:
            owner = getattr(owner, part)
        if leaf.path[-1] not in {field.name for field in dataclasses.fields(owner)}:
            continue
        for value in bad_values(leaf.annotation):
            tried += 1
            change = {leaf.path[-1]: value}
            reason = refused(lambda owner=owner, change=change: dataclasses.replace(owner, **change), leaf.path[-1])
            wrong += [(".".join(leaf.path), value, reason)] if reason else []
    assert wrong == []
    assert tried > 800


def test_every_table_refuses_a_field_that_does_not_exist():
    wrong, tables = [], set()
    for tree, plain, leaf in every_leaf():
        path = leaf.path[:-1]
        if (tree.task.kind, path) not in tables:
            tables.add((tree.task.kind, path))
            with table_of(plain, path) as table:
                table["wavelenght"] = 3
                reason = refused(lambda plain=plain: from_plain(EpisodeConfig, plain), "wavelenght")
                wrong += [(path, reason)] if reason else []
    assert wrong == []
    assert len(tables) > 30


@pytest.mark.parametrize("task", TASKS.names())
def test_a_tree_survives_its_way_through_a_file(task):
    tree = EpisodeConfig.of(task=task, motion="both", seed=7, perception_latency_ms=12.5, actuation="ur5-cb")
    assert from_plain(EpisodeConfig, to_plain(tree)) == tree
