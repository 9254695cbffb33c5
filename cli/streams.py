"""Standard streams that may be closed, full, or without a reader: no work is lost for want of a place to report it."""

import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import TextIO


class PatientStream(io.TextIOBase):
    """A stream that goes quiet when it cannot be written any more, and remembers why."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.error: OSError | None = None
        """Why the stream went quiet."""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """The other stream's encoding."""
        return self._stream.encoding

    def fileno(self) -> int:
        """Return the other stream's descriptor."""
        return self._stream.fileno()

    def isatty(self) -> bool:
        """Return whether the other stream is a terminal."""
        return self._stream.isatty()

    def write(self, text: str) -> int:
        """Write, unless that failed before."""
        self._attempt(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush, unless writing failed before."""
        self._attempt(self._stream.flush)

    def _attempt(self, call: Callable[[], object]) -> None:
        if self.error is not None:
            return
        try:
            call()
        except OSError as error:
            self.error = error
            # What is still in the buffer would fail once more when Python ends.
            with suppress(OSError), Path(os.devnull).open("wb") as nowhere:
                os.dup2(nowhere.fileno(), self._stream.fileno())


@contextmanager
def patient_streams() -> Iterator[tuple[PatientStream, PatientStream]]:
    """Make the standard output and the standard error stream patient inside the block, and give both."""
    for descriptor in range(3):
        # A closed stream's number must not go to the next file that is opened.
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # noqa: FBT003 - it takes no keyword
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere:
        out, error = PatientStream(sys.stdout or nowhere), PatientStream(sys.stderr or nowhere)
        with redirect_stdout(out), redirect_stderr(error):
            yield out, error
