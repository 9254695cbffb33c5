import os
import subprocess
import sys
import warnings
from importlib.metadata import version

import pytest

from laploop.cli.main import COMMANDS, main
from laploop.errors import InvalidValueError, LaploopError, LaploopNote, OutputError, SimulationError, WorkerError


def install(monkeypatch, behaviour):
    """Make `laploop fake` run a function."""
    module = type(sys)("laploop.cli.commands.fake")
    module.main = behaviour
    monkeypatch.setitem(sys.modules, "laploop.cli.commands.fake", module)
    monkeypatch.setitem(COMMANDS, "fake", "fake")


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


def test_a_note_of_the_library_is_one_line_on_the_error_stream(monkeypatch, capsys):
    def behaviour(_arguments):
        warnings.warn("the phantom was simplified", LaploopNote, stacklevel=2)
        return 0

    install(monkeypatch, behaviour)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        show = warnings.showwarning
        assert main(["fake"]) == 0
        assert warnings.showwarning is show
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "laploop fake: the phantom was simplified\n")


def test_no_command_shows_the_help_and_is_bad_input(capsys):
    assert main([]) == 2
    assert "commands:" in capsys.readouterr().err


def test_unknown_command_lists_what_exists(capsys):
    assert main(["fly"]) == 2
    assert capsys.readouterr().err == f"laploop: unknown command 'fly'; available: {', '.join(sorted(COMMANDS))}\n"


def test_unknown_command_names_the_nearest(capsys):
    assert main(["trial"]) == 2
    assert capsys.readouterr().err.startswith("laploop: unknown command 'trial'; did you mean 'trials'? available: ")


def test_no_help_loads_what_computes():
    code = (
        "import contextlib, io, sys\n"
        "from laploop.cli.main import COMMANDS, main\n"
        "heavy = {'torch', 'mujoco', 'warp', 'pinocchio', 'matplotlib', 'rerun'}\n"
        "for arguments in (['--help'], *([name, '--help'] for name in COMMANDS)):\n"
        "    with contextlib.redirect_stdout(io.StringIO()):\n"
        "        assert main(arguments) == 0, arguments\n"
        "    assert not heavy & set(sys.modules), (arguments, heavy & set(sys.modules))\n"
    )
    subprocess.run([sys.executable, "-P", "-c", code], check=True)  # noqa: S603


@pytest.mark.parametrize(
    ("code", "limit_s"), [("from laploop.cli.main import main; main(['--help'])", 0.6), ("import laploop.envs", 2.0)]
)
def test_help_and_import_are_quick(code, limit_s):
    """CPU time, twice what is aimed at: 0.3 s and 1 s on a free core."""
    measured = f"{code}\nimport sys, time; sys.stderr.write(str(time.process_time()))"
    done = subprocess.run([sys.executable, "-P", "-c", measured], capture_output=True, text=True, check=True)  # noqa: S603
    assert float(done.stderr) < limit_s


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (InvalidValueError("seed", -1, "0 or more"), 2, "laploop fake: seed is -1; allowed: 0 or more\n"),
        (SimulationError("MuJoCo warned of BADQACC"), 1, "laploop fake: MuJoCo warned of BADQACC\n"),
        (WorkerError("a worker process died"), 1, "laploop fake: a worker process died\n"),
        (KeyboardInterrupt(), 130, "laploop fake: interrupted\n"),
        (FileNotFoundError(2, "No such file or directory", "a/b"), 2, "laploop fake: a/b: No such file or directory\n"),
        (OSError(28, "No space left on device"), 1, "laploop fake: No space left on device\n"),
        (MemoryError(), 1, "laploop fake: out of memory\n"),
        (LaploopError("two\nlines"), 2, "laploop fake: two lines\n"),
    ],
)
def test_error_becomes_one_line_and_a_status(monkeypatch, capsys, error, status, message):
    install(monkeypatch, failing(error))
    assert main(["fake"]) == status
    assert capsys.readouterr().err == message


def test_full_disk_is_no_bad_input(monkeypatch, capsys):
    def behaviour(_arguments):
        raise OutputError("cannot write x: No space left on device") from OSError(28, "No space left on device")

    install(monkeypatch, behaviour)
    assert main(["fake"]) == 1
    assert capsys.readouterr().err == "laploop fake: cannot write x: No space left on device\n"


def test_notes_of_an_error_are_told_in_the_same_line(monkeypatch, capsys):
    error = KeyboardInterrupt()
    error.add_note("the recording up to then is kept in x")
    install(monkeypatch, failing(error))
    assert main(["fake"]) == 130
    assert capsys.readouterr().err == "laploop fake: interrupted; the recording up to then is kept in x\n"


@pytest.mark.parametrize(("code", "status"), [(None, 0), (0, 0), (2, 2), ("message", 1)])
def test_command_that_exits_by_itself_gives_its_status(monkeypatch, code, status):
    install(monkeypatch, failing(SystemExit(code)))
    assert main(["fake"]) == status


def test_status_and_arguments_are_those_of_the_command(monkeypatch):
    seen = []
    install(monkeypatch, lambda arguments: seen.append(arguments) or 1)
    assert main(["fake", "--out", "x"]) == 1
    assert seen == [["--out", "x"]]


def test_mistakes_of_our_own_are_not_hidden(monkeypatch):
    install(monkeypatch, failing(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        main(["fake"])


def test_a_command_computes_on_one_thread_of_the_linear_algebra_library():
    code = (
        "import sys, types, threadpoolctl; from laploop.cli import main as entry\n"
        "fake = types.ModuleType('laploop.cli.commands.fake')\n"
        "fake.main = lambda _: print({pool['num_threads'] for pool in threadpoolctl.threadpool_info()}) or 0\n"
        "sys.modules[fake.__name__] = fake; entry.COMMANDS['fake'] = 'fake'; sys.exit(entry.main(['fake']))"
    )
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True, env=environment)  # noqa: S603
    assert done.stdout == "{1}\n"
