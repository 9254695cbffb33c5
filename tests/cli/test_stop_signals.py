import signal
import subprocess
import sys
import textwrap

import pytest

COMMAND = """
import sys, time, types
from laploop.cli import main as entry

def work():
    sys.stdout.write("ready\\n")
    sys.stdout.flush()
    time.sleep(60)

class LosesExceptions:
    def __del__(self):
        work()

def command(arguments):
    {body}

module = types.ModuleType("laploop.cli.commands.fake")
module.main = command
sys.modules["laploop.cli.commands.fake"] = module
entry.COMMANDS["fake"] = "works"
sys.argv = ["laploop", "fake"]
sys.exit(entry.main())
"""

BODIES = {
    "working": "work()",
    "swallowing the exception": """
    while True:
        try:
            work()
        except KeyboardInterrupt:
            pass
    """,
    "in a callback that loses the exception": """
    LosesExceptions()
    time.sleep(60)
    """,
    "ending in another error": """
    try:
        work()
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
