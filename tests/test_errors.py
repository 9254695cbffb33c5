import pickle

import pytest

from laploop.errors import (
    InvalidValueError,
    LaploopError,
    MissingFileError,
    OutputError,
    UnknownNameError,
    WeightsError,
    check_range,
)


@pytest.mark.parametrize(
    ("error", "builtin", "message"),
    [
        (InvalidValueError("speed", -1, "0 or more"), ValueError, "speed is -1; allowed: 0 or more"),
        (UnknownNameError("task", "fly", ["reach", "look"]), ValueError, "unknown task 'fly'; available: look, reach"),
        (MissingFileError("weights", "a/b", "train them"), FileNotFoundError, "weights not found at a/b; train them"),
        (WeightsError("truncated"), ValueError, "truncated"),
    ],
)
def test_an_error_is_one_of_ours_and_the_natural_builtin_and_survives_a_process_border(error, builtin, message):
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301  our own bytes
    for each in (error, copy):
        assert isinstance(each, LaploopError)
        assert isinstance(each, builtin)
        assert str(each) == message
    assert type(copy) is type(error)


def test_the_systems_error_behind_one_of_ours_survives_a_process_border():
    error = OutputError("cannot write x")
    error.__context__ = OSError(28, "No space left on device")
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301  our own bytes
    assert copy.__context__.errno == 28


def test_a_range_includes_its_ends_and_leaves_out_what_is_not_a_number():
    for value in (0.0, 0.5, 1.0):
        check_range("share", value, 0.0, 1.0)
    for value in (-0.1, 1.1, float("nan")):
        with pytest.raises(InvalidValueError, match=r"share is .*; allowed: 0 to 1"):
            check_range("share", value, 0.0, 1.0)
