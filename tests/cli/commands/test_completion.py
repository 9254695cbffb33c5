import shutil
import subprocess

import pytest

from laploop.cli.main import main

ASK = """
source {script}
ask() {{
  COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${{#COMP_LINE}}
  _tyro_laploop; echo "${{COMPREPLY[@]}}"
}}
ask laploop do
ask laploop run --mot
ask laploop run --motion brea
ask laploop view --w
"""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_gets_a_script_with_all_commands(shell, capsys):
    assert main(["completion", shell]) == 0
    script = capsys.readouterr().out
    for word in ("doctor", "import-pairs", "--hold-s", "--web", "ur5-cb"):
        assert word in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_choices(tmp_path, capsys):
    assert main(["completion", "bash"]) == 0
    (tmp_path / "script").write_text(capsys.readouterr().out)
    bash = str(shutil.which("bash"))
    done = subprocess.run([bash, "-c", ASK.format(script=tmp_path / "script")], capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.splitlines() == ["doctor", "--motion", "breathing", "--web"]


def test_an_unknown_shell_is_refused(capsys):
    assert main(["completion", "tcsh"]) == 2
    assert "'tcsh'; allowed: bash, zsh, fish" in capsys.readouterr().err
