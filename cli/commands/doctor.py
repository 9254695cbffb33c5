"""`laploop doctor`: whether this machine has what laploop needs."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from laploop.cli.console import ResultTable, progress_bar
from laploop.cli.parsing import parse


@dataclass(frozen=True, kw_only=True)
class DoctorArguments:
    """Look at versions, CPU, GPU, caches, disk, display and extras, and run the loop for three simulated seconds.

    Names the command that mends what is missing. The exit status is 1 if something keeps laploop from working.
    """

    json: bool = False
    """Print the findings as JSON, for a bug report; nothing in them names you."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(DoctorArguments, arguments, "doctor")

    from laploop.studies.doctor.run import LOOP_S, as_report, examine  # slow to import

    with progress_bar("simulated seconds", LOOP_S) as advance_to:
        found = examine(advance_to)
    if chosen.json:
        sys.stdout.write(json.dumps(as_report(found), indent=2) + "\n")
    else:
        table = ResultTable("this machine")
        for check in found:
            table.row(check.name, check.found, f"to mend: {check.remedy}" if check.remedy else "")
        table.show()
    return 1 if any(check.verdict == "bad" for check in found) else 0
