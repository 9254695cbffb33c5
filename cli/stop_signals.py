"""How SIGTERM and Ctrl-C stop a command."""

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

STOP_SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
"""What a command says that one of them stopped."""

_GRACE_S = 4.0
_RETRY_S = 0.05


@contextmanager
def stop_signals(name: str) -> Iterator[list[int]]:
    """Let SIGTERM take the same way out as Ctrl-C, a `KeyboardInterrupt`, which leaves nothing half-written.

    Yields the signals received so far. Where the exception is lost, in a callback for example, it is raised again; where a call
    into a library holds it up, the process ends after four seconds in any case, with a message that begins with `name`.
    """
    received: list[int] = []
    armed = True

    def stop(number: int, _frame: FrameType | None) -> None:
        nonlocal armed
        received.append(number)
        if armed:
            armed = False
            raise KeyboardInterrupt

    def raise_again(lost: "sys.UnraisableHookArgs") -> None:
        nonlocal armed
        if received and issubclass(lost.exc_type, KeyboardInterrupt):
            armed = True
            threading.Timer(_RETRY_S, os.kill, (os.getpid(), received[0])).start()
        else:
            hook(lost)

    hook, sys.unraisablehook = sys.unraisablehook, raise_again
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    handlers = {number: signal.signal(number, stop) for number in STOP_SIGNALS}
    # Written by the C level of Python at once, even while a library's call keeps the handler waiting.
    wakeup = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end_in_time, args=(reader, name), daemon=True).start()
    try:
        yield received
    finally:
        sys.unraisablehook = hook
        signal.set_wakeup_fd(wakeup)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        os.close(writer)


def _end_in_time(reader: int, name: str) -> None:
    """End the process some seconds after a stop signal was written to the pipe, unless the pipe is closed before."""
    with os.fdopen(reader, "rb", buffering=0) as numbers:
        while number := numbers.read(1):
            if number[0] in STOP_SIGNALS:
                break
        else:
            return
        deadline = time.monotonic() + _GRACE_S
        while select.select([numbers], [], [], max(0.0, deadline - time.monotonic()))[0]:
            if not numbers.read(1):
                return
    with suppress(OSError):
        os.write(2, f"{name}: {STOP_SIGNALS[signal.Signals(number[0])]}\n".encode())
    os._exit(128 + number[0])
