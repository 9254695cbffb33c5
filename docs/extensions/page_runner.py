"""Run the code of a page as it is printed, and compare what it prints.

Blocks of `python` share one namespace; blocks of `sh` run in a shell; all share one folder. A `python` block whose first line
is a comment with a file's name is written to that file. A block of `output` is what the block before it prints: `...` stands
for any text, and numbers may differ by 5 % or by one in their last place, since processors round differently.

`python -P docs/extensions/page_runner.py PAGE` runs one page in the current folder and shows what its blocks print.
"""

import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RUN = ("python", "sh")
"""Languages that are run; all others are for reading."""
OUTPUT = "output"

_FENCE = re.compile(r"^```(?P<language>\w*)\n(?P<text>.*?)^```$", flags=re.DOTALL | re.MULTILINE)
_FILE = re.compile(r"# (?P<name>[\w./-]+\.\w+)")
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_RELATIVE = 0.05


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block of a page."""

    language: str
    text: str
    line: int
    """Of its first fence, counted from 1."""

    @property
    def file(self) -> str | None:
        """Name of the file to write it to; None if it is to be run."""
        found = _FILE.fullmatch(self.text.partition("\n")[0])
        return None if found is None or self.language != "python" else found["name"]


def blocks_of(page: str) -> list[Block]:
    """Return the fenced blocks of a page in their order."""
    return [
        Block(language=found["language"], text=found["text"], line=page.count("\n", 0, found.start()) + 1)
        for found in _FENCE.finditer(page)
    ]


def run_page(page: Path, folder: Path) -> Iterator[tuple[Block, str, str | None]]:
    """Run a page's blocks in a folder, which is the working folder too.

    Yields:
        Each block that was run, what it printed, and what the page says that it prints; None where it does not say.

    Raises:
        subprocess.CalledProcessError: If a shell block fails. A Python block raises what it raises.
    """
    blocks = blocks_of(page.read_text(encoding="utf-8"))
    namespace: dict[str, Any] = {"__name__": "__page__"}
    for block, after in zip(blocks, [*blocks[1:], None], strict=True):
        if block.language not in RUN:
            continue
        said = after.text if after is not None and after.language == OUTPUT else None
        yield block, run_block(block, f"{page.name}:{block.line}", namespace, folder), said


def difference(said: str, printed: str) -> str | None:
    """Return where what a page says differs from what its block printed; None if it does not."""
    if len(numbers := _NUMBER.findall(said)) and "..." not in said and len(numbers) != len(_NUMBER.findall(printed)):
        return f"the page says\n{said}but it prints\n{printed}"
    pattern = "".join(
        ".*?" if part == "..." else rf"({_NUMBER.pattern})" if _NUMBER.fullmatch(part) else _loose(part)
        for part in re.split(rf"(\.\.\.|{_NUMBER.pattern})", said.strip())
    )
    found = re.fullmatch(pattern, printed.strip(), flags=re.DOTALL)
    if found is None:
        return f"the page says\n{said}but it prints\n{printed}"
    wrong = [(one, other) for one, other in zip(numbers, found.groups(), strict=True) if not _near(one, other)]
    return f"the page says {wrong[0][0]} where it prints {wrong[0][1]}" if wrong else None


def _loose(text: str) -> str:
    return r"\s+".join(re.escape(part) for part in re.split(r"\s+", text))


def _near(said: str, printed: str) -> bool:
    unit = 10.0 ** -len(said.partition("e")[0].partition(".")[2])
    return abs(float(said) - float(printed)) <= max(1.001 * unit, _RELATIVE * abs(float(said)))


def run_block(block: Block, place: str, namespace: dict[str, Any], folder: Path) -> str:
    """Run a block in a folder and return what it printed; `place` is what errors call it.

    Raises:
        subprocess.CalledProcessError: If a shell block fails. A Python block raises what it raises.
    """
    if block.file is not None:
        (folder / block.file).write_text(block.text, encoding="utf-8")
        return ""
    if block.language == "sh":
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
        done = subprocess.run(  # noqa: S603  our own pages
            ["bash", "-e", "-o", "pipefail", "-c", block.text],  # noqa: S607
            cwd=folder,
            env={**os.environ, "PATH": path},
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
        return done.stdout
    out = io.StringIO()
    with redirect_stdout(out):
        exec(compile(block.text, place, "exec"), namespace)  # noqa: S102  our own pages
    return out.getvalue()


if __name__ == "__main__":
    for ran, text, expected in run_page(Path(sys.argv[1]), Path.cwd()):
        verdict = "" if expected is None else difference(expected, text) or "as the page says"
        sys.stdout.write(f"--- line {ran.line}\n{text}{verdict}\n")
