"""The results on the page of the learners, from the committed table of their runs.

`python -P -m laploop.studies.readme.baselines_page docs/results/baselines.json docs/baselines.md` rewrites the results;
a test checks that it is up to date.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from laploop.studies.learners.baselines import baselines_table
from laploop.studies.readme.results_page import with_results
from laploop.studies.readme.study_pages import NOTHING
from laploop.whole_file import whole_file


def baselines_block(table: Mapping[str, Any] | None) -> str:
    """Return what the page says of the runs: on which machines they were, and what they reached."""
    if table is None or not table["runs"]:
        return NOTHING
    runs = table["runs"].values()
    machines = sorted({f"{run['machine']['usable_cores']} cores of {run['machine']['cpu']}" for run in runs})
    versions = sorted({run["versions"]["laploop"] for run in runs})
    return f"laploop {', '.join(versions)}, {', '.join(machines)}.\n\n{baselines_table(table['runs'])}"


def main(arguments: Sequence[str]) -> None:
    """Rewrite the page: `arguments` are the file of the table and the page."""
    source, page = (Path(argument) for argument in arguments)
    table = json.loads(source.read_text(encoding="utf-8")) if source.is_file() else None
    text = with_results(page.read_text(encoding="utf-8"), baselines_block(table))
    with whole_file(page) as partial:
        partial.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
