import subprocess
import sys
from importlib.metadata import version

import pytest

from laploop.cli import main as entry
from laploop.cli.main import COMMANDS, main
from laploop.errors import InvalidValueError, SimulationError


def install(monkeypatch, behaviour):
    """Make `laploop fake` run a function."""
    module = type(sys)("laploop.cli.commands.fake")
    module.main = behaviour
    monkeypatch.setitem(sys.modules, "laploop.cli.commands.fake", module)
    monkeypatch.setitem(COMMANDS, "fake", "fake")
    monkeypatch.setattr(entry.signal, "signal", lambda *_: None)


def failing(error):
    def behaviour(_arguments):
        raise error

    return behaviour


def test_help_lists_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {name} " in out for name in COMMANDS)


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from laploop.cli.main import main; main(['--help']); print('heavy', {'torch', 'mujoco'} & {*sys.modules})"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)  # noqa: S603
    assert "heavy set()" in done.stdout


def test_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"laploop {version('laploop')}\n"


def test_no_command_shows_the_help_and_is_bad_input(capsys):
    assert main([]) == 2
    assert "commands:" in capsys.readouterr().err


def test_unknown_command_lists_what_exists(capsys):
    assert main(["fly"]) == 2
    assert capsys.readouterr().err == f"laploop: unknown command 'fly'; available: {', '.join(sorted(COMMANDS))}\n"


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (InvalidValueError("seed", -1, "0 or more"), 2, "laploop fake: seed is -1; allowed: 0 or more\n"),
        (SimulationError("MuJoCo warned of BADQACC"), 1, "laploop fake: MuJoCo warned of BADQACC\n"),
        (KeyboardInterrupt(), 130, "laploop fake: interrupted\n"),
    ],
)
def test_error_becomes_one_line_and_a_status(monkeypatch, capsys, error, status, message):
    install(monkeypatch, failing(error))
    assert main(["fake"]) == status
    assert capsys.readouterr().err == message


def test_status_and_arguments_are_those_of_the_command(monkeypatch):
    seen = []
    install(monkeypatch, lambda arguments: seen.append(arguments) or 1)
    assert main(["fake", "--out", "x"]) == 1
    assert seen == [["--out", "x"]]


def test_mistakes_of_our_own_are_not_hidden(monkeypatch):
    install(monkeypatch, failing(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["fake"])
