"""What is installed and available on a machine, and how to mend what is missing."""

import os
import re
import shutil
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from laploop.envs.recording.viewer import has_display
from laploop.errors import LaploopError
from laploop.studies.timing.machine import describe_machine

_LEAST_FREE_GB = 2.0
"""Room for the compiled kernels and a few recordings."""
_BUSY = 0.5
"""Mean number of busy processes above which times say little."""

Verdict = Literal["good", "optional", "bad"]


@dataclass(frozen=True, kw_only=True)
class Check:
    """One finding."""

    name: str
    found: str
    verdict: Verdict = "good"
    """Whether it is as it should be, missing without harm, or keeps laploop from working."""
    remedy: str = ""
    """Command or step that mends it."""


def checks() -> Iterator[Check]:
    """Yield all findings but the loop's speed; nothing in them names the user."""
    yield from _packages()
    yield from _machine()
    yield _kernel_cache()
    yield from _disk()
    yield _display()
    yield from _extras()


def _packages() -> Iterator[Check]:
    yield Check(name="laploop", found=version("laploop"))
    for name in _names(requires("laploop") or [], extra=None):
        found = _version(name)
        if found is None:
            yield Check(name=name, found="missing", verdict="bad", remedy="pip install --upgrade laploop")
        else:
            yield Check(name=name, found=found)


def _machine() -> Iterator[Check]:
    machine = describe_machine()
    yield Check(name="Python", found=f"{machine['python']} on {machine['system']}")
    yield Check(name="CPU", found=f"{machine['cpu']}, {machine['usable_cores']} cores, {machine['memory_gib']:.0f} GiB")
    yield Check(name="GPU", found=machine["gpu"] or "none; none is needed")
    busy = machine["load_1min"] > _BUSY
    yield Check(
        name="load",
        found=f"{machine['load_1min']:.1f} busy processes in the last minute",
        verdict="optional" if busy else "good",
        remedy="let nothing else run while you measure" if busy else "",
    )


def _kernel_cache() -> Check:
    from laploop.envs.sensors.tracing.device import kernel_cache, open_device  # slow to import

    try:
        open_device("cpu")
    except LaploopError as error:
        return Check(
            name="compiled kernels", found=str(error), verdict="bad", remedy="export WARP_CACHE_PATH=/a/writable/folder"
        )
    folder = kernel_cache()
    size_mb = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6
    return Check(name="compiled kernels", found=f"{size_mb:.0f} MB in {_without_user(folder)}")


def _disk() -> Iterator[Check]:
    for name, folder in (("disk, here", Path.cwd()), ("disk, home", Path.home())):
        free_gb = shutil.disk_usage(folder).free / 1e9
        short = free_gb < _LEAST_FREE_GB
        yield Check(
            name=name,
            found=f"{free_gb:.0f} GB free",
            verdict="bad" if short else "good",
            remedy=f"make room: at least {_LEAST_FREE_GB:.0f} GB" if short else "",
        )
    writable = os.access(Path.cwd(), os.W_OK)
    yield Check(
        name="working folder",
        found="writable" if writable else "not writable",
        verdict="good" if writable else "optional",
        remedy="" if writable else "give commands an --out that is writable",
    )


def _display() -> Check:
    if has_display():
        return Check(name="display", found="there is one")
    return Check(
        name="display", found="none", verdict="optional", remedy="laploop view --web RUN shows recordings in a browser"
    )


def _extras() -> Iterator[Check]:
    wanted = requires("laploop") or []
    for extra in metadata("laploop").get_all("Provides-Extra") or []:
        missing = [name for name in _names(wanted, extra=extra) if name != "laploop" and _version(name) is None]
        yield Check(
            name=f"extra {extra}",
            found=f"without {', '.join(missing)}" if missing else "installed",
            verdict="optional" if missing else "good",
            remedy=f"pip install 'laploop[{extra}]'" if missing else "",
        )
    yield Check(
        name="video", found="H.264" if find_spec("imageio_ffmpeg") is not None else "MPEG-4, which browsers do not play"
    )


def _names(requirements: list[str], *, extra: str | None) -> list[str]:
    """Return the packages that an extra needs, or, for None, those that are always needed."""
    found = []
    for requirement in requirements:
        marked = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", requirement)
        if (marked.group(1) if marked else None) == extra and (name := re.match(r"[\w.-]+", requirement)):
            found.append(name.group())
    return found


def _version(package: str) -> str | None:
    try:
        with warnings.catch_warnings(action="ignore"):
            return version(package)
    except PackageNotFoundError:
        return None


def _without_user(path: Path) -> str:
    """Return a path with the home folder as ~: a report goes to others."""
    return f"~/{path.relative_to(Path.home())}" if path.is_relative_to(Path.home()) else str(path)
