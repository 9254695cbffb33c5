"""Rerun's viewer as a process of its own: in a window, or as a page in the browser.

The viewer is the program of the package rerun-sdk itself, not the script of that name, which would leave it running.
"""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from laploop.errors import InfeasibleError, MissingFileError

RECORDING = "recording.rrd"
"""Name of the recording in the folder of a run."""

LOCALHOST = "127.0.0.1"
STREAM_PORT = 9876
"""Where a viewer listens for recordings; Rerun's own default."""
PAGE_PORT = 9090
"""Of the page, where it is free."""

_START_S = 30.0
_STOP_S = 5.0


def recording_in(place: Path) -> Path:
    """Return the recording at a path, or in the folder of a run.

    Raises:
        MissingFileError: If there is none.
    """
    found = place / RECORDING if place.is_dir() else place
    if not found.is_file():
        raise MissingFileError("recording", found, "`laploop run --out DIR` makes one in DIR")
    return found


def has_display() -> bool:
    """Return whether a window can be opened."""
    return sys.platform in {"darwin", "win32"} or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def show_in_window(recording: Path) -> int:
    """Open a recording in a window, wait until it is closed, and return the viewer's exit status.

    Raises:
        InfeasibleError: If there is no display.
    """
    _require_display("look at it in the browser with `laploop view --web`")
    with _running([str(recording), *_bound(free_port())]) as viewer:
        return viewer.wait()


@contextmanager
def page(recording: Path | None, *, port: int | None = None, stream_port: int | None = None) -> Iterator[tuple[str, str]]:
    """Serve the viewer as a page of this machine alone while the block runs.

    Args:
        recording: What to show; None waits for one that is streamed.
        port: Of the page; by default 9090, or any where that is taken.
        stream_port: Where recordings are streamed to; likewise 9876.

    Yields:
        The addresses of the page and of the stream.

    Raises:
        InfeasibleError: If a given port is taken, or the viewer ends at once.
    """
    of_page, of_stream = _port(port, PAGE_PORT), _port(stream_port, STREAM_PORT)
    stream = stream_address(of_stream)
    options = ["--serve-web", *_bound(of_stream), "--web-viewer-port", str(of_page)]
    with _running([*options, *([] if recording is None else [str(recording)])]) as viewer:
        _await_port(of_page, viewer)
        yield f"http://{LOCALHOST}:{of_page}/?url={quote(stream, safe=':/')}", stream


def live_viewer(port: int = STREAM_PORT) -> str:
    """Return the address to stream to: that of a viewer which listens at the port, or of a new one in a window, which stays.

    Raises:
        InfeasibleError: If no viewer listens and there is no display for a new one.
    """
    if not is_listening(port):
        _require_display("start `laploop view --web` first and open the page that it names")
        viewer = subprocess.Popen(  # noqa: S603 - the program of a package that is installed with us
            [str(_program()), *_bound(port), "--expect-data-soon"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        _await_port(port, viewer)
    return stream_address(port)


def stream_address(port: int) -> str:
    """Return the address under which a viewer of this machine takes recordings."""
    return f"rerun+http://{LOCALHOST}:{port}/proxy"


def is_listening(port: int) -> bool:
    """Return whether a program of this machine listens at a port."""
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((LOCALHOST, port)) == 0


def free_port() -> int:
    """Return a port that nobody uses."""
    with socket.socket() as probe:
        probe.bind((LOCALHOST, 0))
        return int(probe.getsockname()[1])


def _bound(port: int) -> list[str]:
    """Return the options with which a viewer takes recordings from this machine alone; by itself it listens to all."""
    return ["--bind", LOCALHOST, "--port", str(port)]


def _port(given: int | None, usual: int) -> int:
    if given is not None and is_listening(given):
        raise InfeasibleError(f"port {given} is taken; choose another, or none to have a free one chosen")
    return given if given is not None else free_port() if is_listening(usual) else usual


def _program() -> Path:
    package = find_spec("rerun_cli")
    place = Path("rerun_cli") if package is None or package.origin is None else Path(package.origin).parent
    for name in ("rerun", "rerun.exe"):
        if (place / name).is_file():
            return place / name
    raise MissingFileError("viewer", place, "install it: pip install --force-reinstall rerun-sdk")


def _require_display(remedy: str) -> None:
    if not has_display():
        raise InfeasibleError(f"there is no display for a window; {remedy}")


@contextmanager
def _running(options: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer, and end it with the block."""
    quiet = {**os.environ, "RUST_LOG": "error"}
    viewer = subprocess.Popen([str(_program()), *options], env=quiet, stdin=subprocess.DEVNULL)  # noqa: S603 - see above
    try:
        yield viewer
    finally:
        viewer.terminate()
        try:
            viewer.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            viewer.kill()
            viewer.wait()


def _await_port(port: int, viewer: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + _START_S
    while not is_listening(port):
        if viewer.poll() is not None or time.monotonic() > deadline:
            raise InfeasibleError(f"the viewer did not start; see what `{_program()} --port {port}` says")
        time.sleep(0.05)
