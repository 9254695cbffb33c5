"""`laploop view`: a recording in Rerun's viewer."""

import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from laploop.cli.parsing import parse
from laploop.envs.recording.viewer import page, recording_in, show_in_window


@dataclass(frozen=True, kw_only=True)
class ViewArguments:
    """Open a recording in Rerun's viewer: in a window, or with --web as a page of this machine alone, until Ctrl-C.

    Without a recording, the page waits for one that `laploop run --live` streams.
    """

    run: tyro.conf.Positional[Path | None] = None
    """Folder of a run, or its recording (.rrd)."""
    web: bool = False
    """Serve a page at 127.0.0.1, and print its address, in place of a window."""
    port: int | None = None
    """Port of the page; by default 9090, or a free one where that is taken."""


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    chosen = parse(ViewArguments, arguments, "view")
    recording = None if chosen.run is None else recording_in(chosen.run)
    if recording is not None and not chosen.web:
        return show_in_window(recording)
    with page(recording, port=chosen.port) as (address, stream):
        sys.stdout.write(f"{address}\n")
        sys.stdout.flush()
        sys.stderr.write(f"laploop view: open the address in a browser; takes live recordings at {stream}; Ctrl-C ends it\n")
        threading.Event().wait()
    return 0
