import signal
import subprocess
import sys
import textwrap

import pytest

COMMAND = """
import sys, time, types
from laploop.cli import main as entry

def waits(arguments):
    sys.stdout.write("ready\\n")
    sys.stdout.flush()
    {body}

module = types.ModuleType("laploop.cli.commands.fake")
module.main = waits
sys.modules["laploop.cli.commands.fake"] = module
entry.COMMANDS["fake"] = "waits"
sys.exit(entry.main(["fake"]))
"""

BODIES = {
    "waiting": "time.sleep(60)",
    "swallowing the exception": """
    while True:
        try:
            time.sleep(60)
        except KeyboardInterrupt:
            pass
    """,
    "ending in another error": """
    try:
        time.sleep(60)
    finally:
        raise ValueError("on the way out")
    """,
}


@pytest.mark.parametrize(
    ("number", "word", "status"), [(signal.SIGTERM, "terminated", 143), (signal.SIGINT, "interrupted", 130)]
)
@pytest.mark.parametrize("state", BODIES)
def test_a_command_that_is_stopped_says_so_in_one_line_and_with_its_status(number, word, status, state):
    code = COMMAND.format(body=textwrap.dedent(BODIES[state]).strip().replace("\n", "\n    "))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)  # noqa: S603
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, error = process.communicate()
    assert error == f"laploop fake: {word}\n"
    assert process.returncode == status
