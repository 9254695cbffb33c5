"""Every option of every command."""

import re

import pytest

from laploop.cli.completion import argument_kinds
from laploop.cli.main import COMMANDS
from laploop.cli.parsing import options_of
from laploop.cli.tree import leaves
from laploop.envs.episode_config import EpisodeConfig
from laploop.envs.tasks.registry import TASKS

BRACKETS = r"\((default|required|.*?(to|above|below|at least|at most|values)).*"
"""What the command line adds to a field's docstring: bounds and the default."""

DURATION = r"-(s|ms|ns)$"
LENGTH = r"-(m|mm|px)$"


@pytest.fixture(scope="module")
def options():
    """Return names and help of all options, by command."""
    return {
        command: [(option.names[-1], option.meaning) for option in options_of(kind) if option.names]
        for command, kind in argument_kinds(list(COMMANDS)).items()
    }


def test_every_option_says_what_it_means(options):
    silent = [
        f"{command} {name}"
        for command, known in options.items()
        for name, text in known
        if not re.sub(BRACKETS, "", text).strip()
    ]
    assert not silent


@pytest.mark.parametrize("task", TASKS.names())
def test_every_field_of_an_episode_says_what_it_means(task):
    assert not [path for path, leaf in leaves(EpisodeConfig.of(task=task)).items() if not leaf.doc.strip()]


def test_times_and_lengths_carry_their_unit_in_the_name_or_the_help(options):
    """Whatever speaks of a time or a length by its meaning says in which unit."""
    silent = []
    for command, known in options.items():
        for name, text in known:
            says_time = re.search(r"seconds|latency|delay|duration", name) and not re.search(r"trace|kind|name", name)
            if says_time and not re.search(DURATION, name) and not re.search(r"\b(s|ms|seconds?|milliseconds?)\b|time", text):
                silent.append(f"{command} {name}")
            if re.search(r"width|distance|radius|clearance", name) and not re.search(LENGTH, name):
                silent += (
                    []
                    if re.search(r"pixel|column|image|tan|metre|\bmm?\b", f"{name} {text}".lower())
                    else [f"{command} {name}"]
                )
    assert not silent
